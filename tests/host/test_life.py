"""One controller from its start to its end: what its commands, `status`, its lines and the service manager are told."""

import json
import os
import signal
from pathlib import Path

import pytest

from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.errors import CheckFailed, DeviceUnavailable
from tests.cells import LEISURELY, WAITING, changed


@pytest.fixture
def cell(run, manager, monkeypatch, tmp_path):
    monkeypatch.setenv("NOTIFY_SOCKET", manager.path)
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    return run(changed(LEISURELY, *WAITING), "--record", str(tmp_path / "run.mcap"))


def all_that_say_ready_agree(cell, manager):
    """`status`, the printed line, the service manager."""
    until(lambda: cell.socket.exists(), cell.last_words)
    seen = set()

    def is_ready():
        told = "READY=1" in manager() or "\nREADY" in cell.said
        with Client(cell.socket) as client:
            report = client.status()
        seen.add((report["state"], report["cycles"] > 0))
        if told:
            assert report["state"] == "READY"
        if report["state"] != "READY":
            assert report["state"] == "STARTING"
            return False
        assert "READY=1" in manager()
        return True

    until(is_ready, cell.last_words)
    until(lambda: "READY" in cell.said, cell.last_words)
    assert cell.watch().cycles > 0
    assert ("STARTING", True) in seen  # the recorder is started while the loop turns
    before = manager()[: manager().index("READY=1")]
    assert before[0] == "STATUS=STARTING: compiling, opening the drivers, warming up"
    assert set(before[1:]) <= {"STATUS=STARTING", "WATCHDOG=1"}


def it_obeys(cell, client):
    """READY, refused, armed, disarmed, armed again; each state told as it is."""
    with pytest.raises(CheckFailed, match=r"^reset refused: the state is READY$"):
        client.reset()
    client.disarm()  # disarmed it is
    client.arm()
    cell.reach("TRACKING")
    client.disarm()
    cell.reach("READY")
    client.arm()
    cell.reach("TRACKING")
    report = client.status()
    assert report["state"] == "TRACKING"
    assert json.loads(json.dumps(report, allow_nan=False)) == report


def it_is_fed_followed_and_reloads(cell, manager):
    until(lambda: "STATUS=TRACKING" in manager(), cell.last_words)
    until(lambda: manager().count("WATCHDOG=1") >= 2, cell.last_words)
    cell.process.send_signal(signal.SIGHUP)
    until(lambda: manager().count("READY=1") == 2, cell.last_words)
    assert any(message.startswith("RELOADING=1\nMONOTONIC_USEC=") for message in manager())
    until(lambda: "reloaded, changed: nothing" in cell.said, cell.last_words)
    for child in Path(f"/proc/{cell.process.pid}/task/{cell.process.pid}/children").read_text().split():
        os.kill(int(child), signal.SIGHUP)  # as `pkill -HUP` does, or a service manager that tells all
    cell.config.write_text(": : :")
    cell.process.send_signal(signal.SIGHUP)
    until(lambda: manager().count("READY=1") == 3, cell.last_words)
    until(lambda: "WARNING: reload refused: " in cell.said, cell.last_words)
    assert cell.state == "TRACKING"
    assert "STOPPING=1" not in manager()


def test_a_controller_tells_its_life(cell, manager):
    all_that_say_ready_agree(cell, manager)
    with Client(cell.socket) as client:
        it_obeys(cell, client)
        it_is_fed_followed_and_reloads(cell, manager)
        assert cell.end() == 0
        with pytest.raises(DeviceUnavailable, match=r"^the controller on .* went away$"):
            client.status()
    assert manager().count("STOPPING=1") == 1
    starts = rf"^no controller answers on .*; start one with `micromanip run CONFIG --socket {cell.socket}`$"
    with pytest.raises(DeviceUnavailable, match=starts):
        Client(cell.socket)
