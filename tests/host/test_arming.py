"""Arming a controller in real processes: what it lacks, what was never checked, and when it is ready at all."""

import re
from contextlib import suppress

import numpy as np
import pytest

from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.errors import CheckFailed, DeviceUnavailable
from tests.cells import LEISURELY, QUICK, WAITING, calm, changed, rows_of, simulated


@pytest.mark.thorough  # in virtual time: tests/virtual/test_arming.py
@pytest.mark.realtime  # the check of the feedback closes loops: no stall may outlast it
def test_a_dead_capacitive_sensor_after_an_earlier_session(run):
    """Refused: the outer loop is not closed on what the estimator knew then."""
    fault = ("    seed: 1\n", "    seed: 1\n    faults: [{channel: stage_x, kind: drop, at_s: 12}]\n")
    cell = run(simulated(*QUICK, *WAITING, fault)).reach("READY")
    sensor = cell.status["state"][0]["axis"][0]["stage"]
    with Client(cell.socket) as client:
        client.arm()
        cell.reach("TRACKING")
        client.disarm()
        cell.reach("READY")
        assert sensor["silent_ns"] < 1_000_000_000, "it took longer than the sensor was to live"
        until(lambda: sensor["silent_ns"] > 100_000_000, "the sensor's death", 30.0)
        with pytest.raises(CheckFailed, match="arm refused: stage_x is silent"):
            client.arm()
        assert client.status()["state"] == "READY"
    cell.go_on(2000)
    assert not rows_of(cell.ring)["axis"]["voltage_V"][-2000:].any()
    assert cell.end() == 0


def by_hand():
    """x and y follow their gauges, z is a voltage, and what reads as its gauge is that of y."""
    text = calm(*WAITING)
    jog = "reference: {source: jog, offset_um: 60, range_um: [20, 110]}\n"
    text, references = re.subn(r"(?m)^reference: .*\n", jog, text)
    text, modes = re.subn(r"(?s)(\n  z:\n    mode: )strain", r"\g<1>voltage", text)
    text, checks = re.subn("check_s: null", "check_s: 0.4", text)
    text, wires = re.subn(r"strain_z: \{driver: cell,", "strain_z: {driver: cell, channel: strain_y,", text)
    assert (references, modes, checks, wires) == (1, 1, 1, 1)
    return text


@pytest.mark.thorough  # the same
@pytest.mark.realtime  # the same
def test_a_loop_that_was_never_closed_is_checked_before_it_is(run):
    """Another mode after a session without it: the gauge does not answer, X-401, and the voltage has moved by 5 V."""
    cell = run(by_hand()).reach("READY")
    with Client(cell.socket) as client:
        client.arm()
        cell.reach("TRACKING")
        client.disarm()
        cell.reach("READY")
        client.set({"axes.z.mode": "strain"})
        first = int(cell.status["words"][0])
        client.arm()
        cell.reach("FAULT")
        assert client.status()["faults"][0].startswith("X-401 axis z: ")
    rows = rows_of(cell.ring)
    voltage = rows["axis"]["voltage_V"][rows["cycle"] > first]
    assert 4.0 < voltage[:, 2].max() <= 5.0 + 1e-9
    assert not voltage[:, :2].any()  # what was checked in the first session is not checked again
    assert cell.end() == 1


def test_arm_a_moment_before_ready_waits_for_it(run, manager, monkeypatch, tmp_path):
    """Once it is: tests/host/test_life.py."""
    monkeypatch.setenv("NOTIFY_SOCKET", manager.path)
    cell = run(changed(LEISURELY, *WAITING), "--record", str(tmp_path / "run.mcap")).watch()
    until(lambda: cell.cycles > 0, cell.last_words)
    with suppress(DeviceUnavailable), Client(cell.socket) as client:
        client.arm()
    assert "READY=1" in manager()
    cell.reach("TRACKING")
    assert np.isfinite(rows_of(cell.ring)["axis"]["voltage_V"]).all()
    assert cell.end() == 0
