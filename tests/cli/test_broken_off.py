"""Live experiments: one daemon serves them, READY in between; of a run that was broken off none is made twice."""

import os
import signal
import threading
import time

import numpy as np
import pytest

from micromanip.cli import live_experiment
from micromanip.cli.live_experiment import LiveCell, LiveExperiment
from micromanip.cli.new import text_for
from micromanip.client import Client
from micromanip.design.experiment import Ended, with_axes
from micromanip.errors import CheckFailed
from micromanip.rt.states import RAMPING
from micromanip.settings.check import prepared
from micromanip.settings.text.source import Source

SECONDS = 0.5
FIRST, SECOND = (np.full((10, 3), volts) for volts in (1.0, 2.0))


@pytest.fixture
def cell(tmp_path, request):
    text = text_for("simulated", ["x"], rate_hz=1000).replace("limits: hardware", "limits: simulation")
    text = text.replace("seed: 1}", f"seed: 1, faults: [{getattr(request, 'param', '')}]}}")
    return prepared(Source.parse(tmp_path / "cell.yaml", text))


@pytest.fixture
def begin(cell, tmp_path):
    begun = []

    def begin():
        begun.append(LiveCell(cell, tmp_path / "control.sock", tmp_path / "kept"))
        return begun[-1]

    yield begin
    for each in begun:
        each.end()


@pytest.mark.live
def test_one_daemon_serves_experiments_and_none_is_made_again(begin, cell, tmp_path):
    configuration, play = cell.configuration, LiveExperiment(live := begin())
    rows = play(configuration, SECONDS, FIRST)
    with Client(tmp_path / "control.sock") as client:
        assert client.status()["state"] == "READY"
        with pytest.raises(CheckFailed, match="experiments are made with this cell"):
            client.arm()
        assert client.status()["axes"]["x"]["voltage_V"]["latest"] == 0.0
    time.sleep(8.0)  # who computes does not listen: what fills a pipe must not hold up the host
    assert play(with_axes(configuration, mode="voltage"), SECONDS, SECOND)["cycle"][0] > rows["cycle"][-1] + 7000
    live.end()

    again = begin()
    assert again.left == 2
    assert np.array_equal(LiveExperiment(again)(configuration, SECONDS, FIRST)["cycle"], rows["cycle"])
    assert not (tmp_path / "control.sock").exists(), "read"
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    threading.Timer(4.0, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        LiveExperiment(again)(configuration, 30.0, SECOND)
    again.end()
    assert begin().left == 2, "half an experiment is none"


@pytest.mark.live
@pytest.mark.parametrize("cell", ["{channel: exchange, kind: error, value: 5, at_s: 10}"], indirect=True)
def test_a_fault_ends_the_daemon_and_the_next_experiment_has_another(begin, cell):
    play = LiveExperiment(begin())
    for _ in range(2):
        with pytest.raises(Ended, match="the experiment was ended by a fault: X-") as ended:
            play(cell.configuration, 60.0, FIRST)
        assert (ended.value.rows["state"] == RAMPING).any(), "with the way to rest"


def test_an_experiment_of_another_day_is_not_taken(cell, tmp_path, monkeypatch):
    (tmp_path / "001-of-today.mcap").touch()
    assert LiveCell(cell, tmp_path / "control.sock", tmp_path).left == 1
    monkeypatch.setattr(live_experiment.time, "time", lambda: tmp_path.stat().st_mtime + 7200.0)
    assert LiveCell(cell, tmp_path / "control.sock", tmp_path).left == 0
