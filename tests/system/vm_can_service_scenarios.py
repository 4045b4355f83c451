"""The whole service on SocketCAN, with a foreign device on the bus: run by ``make test-vm``. No timing."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from host.cell import command_line, until

from .machine import CONFIG, PROGRAM, UNIT, ok
from .vcan import CHANNEL, set_link
from .vm_cell import CAN_TEXT, DATABASES, write
from .vm_service import installed

PATIENCE_S = 60.0


class Peer:
    """The device: ``can_peer.py`` in a process of its own."""

    def __init__(self, folder):
        self._log = folder / "commands"
        self._log.touch()
        arguments = (CHANNEL, str(DATABASES / "manipulator.dbc"), str(self._log))
        self.process = subprocess.Popen([sys.executable, str(Path(__file__).with_name("can_peer.py")), *arguments])

    def commands(self, since_s=0.0):
        """Voltage and count of each command that it got at or after `since_s` (CLOCK_MONOTONIC)."""
        rows = [line.split() for line in self._log.read_text().splitlines() if line.count(" ") == 2]
        return [(float(voltage_V), int(count)) for came_s, voltage_V, count in rows if float(came_s) >= since_s]

    def gets(self, number, since_s):
        """Wait for so many commands; their voltages and counts."""
        until(lambda: len(self.commands(since_s)) >= number, "commands", PATIENCE_S)
        return self.commands(since_s)

    @property
    def voltage_V(self):
        return self.commands()[-1][0]


@pytest.fixture(scope="module")
def peer(tmp_path_factory):
    peer = Peer(tmp_path_factory.mktemp("peer"))
    yield peer
    peer.process.kill()
    peer.process.wait()


@pytest.fixture(scope="module")
def service(peer, tmp_path_factory):
    """Installed and started once."""
    service = installed(write(tmp_path_factory.mktemp("cell"), "can.yaml", CAN_TEXT))
    shutil.copy(DATABASES / "manipulator.dbc", CONFIG.parent)
    service.since = f"{time.time():.6f}"
    yield service.start()
    service.release()


def test_worker_has_fifo_below_the_loop_and_leaves_its_cpu_without_being_root(service):
    assert service.state == "READY"
    [worker] = [pid for pid in service.processes if "micromanip.io.worker" in command_line(pid)]
    status = dict(line.split(":\t", 1) for line in Path(f"/proc/{worker}/status").read_text().splitlines())
    assert Path(f"/proc/{worker}").stat().st_uid == int(ok("id", "-u", "micromanip")) != 0
    assert int(status["CapEff"], 16) == int(status["CapBnd"], 16) == 0
    assert os.sched_getscheduler(worker) == os.SCHED_FIFO
    assert os.sched_getparam(worker).sched_priority == 70 < os.sched_getparam(service.loop).sched_priority
    assert os.sched_getaffinity(service.loop) == {1}
    assert 1 not in os.sched_getaffinity(worker)
    assert "WARNING" not in service.journal()


def test_moves_a_foreign_device_and_a_stepped_wall_clock_is_nothing(service, peer):
    assert {voltage_V for voltage_V, _ in peer.gets(10, 0.0)} == {0.0}
    service.track()
    until(lambda: peer.voltage_V > 50, "voltage", PATIENCE_S)
    for step_s in (3600, -3600):
        ok("date", "--set", f"@{time.time() + step_s:.6f}")
        since_s = time.monotonic()
        voltages_V = [voltage_V for voltage_V, _ in peer.gets(50, since_s)]
        assert min(voltages_V) > 50
    assert service.state == "TRACKING"
    assert service.ring["rows"]["axis"]["strain_um"].max() > 45
    assert "WARNING" not in service.journal()
    link = service.status_report()["buses"]["can0"]
    assert link["link"] == "up"
    assert link["outputs"] == "following"
    assert link["counts"]["lost"] == link["counts"]["overflows"] == 0


def test_interface_down_is_a_fault_and_up_again_the_outputs_rest(service, peer):
    assert service.state == "TRACKING"
    set_link("down")
    until(lambda: service.state in ("RAMPING", "FAULT"), lambda: f"fault\n{service.journal()}", PATIENCE_S)
    service.reach("FAULT")
    until(lambda: "X-108" in service.journal(), service.journal, PATIENCE_S)
    until(lambda: "socketcan-vcan0: vcan0 is down; as root: " in service.journal(), service.journal, PATIENCE_S)
    up_s = time.monotonic()
    set_link("up")
    until(lambda: "driver can0: link up; its outputs stay at rest" in service.journal(), service.journal, PATIENCE_S)
    assert {voltage_V for voltage_V, _ in peer.gets(100, up_s)} == {0.0}
    assert service.state == "FAULT"
    ok(PROGRAM, "reset")
    reset_s = time.monotonic()
    service.reach("READY")
    assert {voltage_V for voltage_V, _ in peer.gets(50, reset_s)} == {0.0}
    service.track()
    until(lambda: peer.voltage_V > 50, "voltage", PATIENCE_S)


def test_stops_with_a_ramp_and_leaves_nothing_behind(service, peer):
    since_s = time.monotonic()
    ok("systemctl", "stop", UNIT)
    assert service.show("Result") == "success"
    voltages_V = [voltage_V for voltage_V, _ in peer.commands(since_s)]
    assert voltages_V[-1] == 0.0
    assert any(0.5 < voltage_V < 50 for voltage_V in voltages_V)
    assert not [entry for entry in Path("/proc").iterdir() if "micromanip.io.worker" in command_line(entry.name)]
    assert peer.process.poll() is None
