"""Arming a controller in real processes a moment before it is ready."""

from contextlib import suppress

import numpy as np

from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.errors import DeviceUnavailable
from tests.cells import LEISURELY, WAITING, changed, rows_of


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
