"""Commissioning that was broken off goes on: experiments that were made are read, and none twice."""

import os
import signal
import threading

import numpy as np
import pytest

from micromanip.cli import live_experiment
from micromanip.cli.live_experiment import LiveExperiment, Recordings
from micromanip.cli.new import text_for
from micromanip.host import daemon
from micromanip.settings.check import prepared
from micromanip.settings.text.source import Source

SECONDS = 0.5


@pytest.fixture
def cell(tmp_path):
    text = text_for("simulated", ["x"], rate_hz=1000).replace("limits: hardware", "limits: simulation")
    return prepared(Source.parse(tmp_path / "cell.yaml", text))


def experiments(cell, tmp_path):
    return LiveExperiment(cell, tmp_path / "control.sock", Recordings(tmp_path / "kept"))


@pytest.mark.live
def test_what_was_made_is_not_made_again(cell, tmp_path, monkeypatch):
    served = daemon.serve
    runs = []
    monkeypatch.setattr(daemon, "serve", lambda *given: runs.append(given) or served(*given))
    first, second = (np.full((10, 12), volts) for volts in (1.0, 2.0))
    rows = experiments(cell, tmp_path)(cell.configuration, SECONDS, first)
    assert len(runs) == 1

    def interrupt():
        os.kill(os.getpid(), signal.SIGINT)

    again = experiments(cell, tmp_path)
    assert np.array_equal(again(cell.configuration, SECONDS, first)["cycle"], rows["cycle"])
    assert len(runs) == 1, "read"
    later = threading.Timer(4.0, interrupt)
    later.start()
    with pytest.raises(KeyboardInterrupt):
        again(cell.configuration, 30.0, second)
    later.join()
    assert Recordings(tmp_path / "kept").left == 1, "half an experiment is none"


def test_an_experiment_of_another_day_or_another_file_is_not_taken(tmp_path, monkeypatch):
    recordings = Recordings(tmp_path / "kept")
    file = recordings.next(b"cell", b"samples")
    file.touch()
    assert Recordings(tmp_path / "kept").next(b"cell", b"samples") == file
    assert Recordings(tmp_path / "kept").next(b"another cell", b"samples") != file
    repeated = Recordings(tmp_path / "kept")
    assert repeated.next(b"cell", b"samples") != repeated.next(b"cell", b"samples"), "a repetition is an experiment"
    monkeypatch.setattr(live_experiment.time, "time", lambda: file.stat().st_mtime + 7200.0)
    assert Recordings(tmp_path / "kept").left == 0
