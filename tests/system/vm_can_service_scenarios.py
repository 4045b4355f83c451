"""The whole service on SocketCAN, with a foreign device on the bus, then a played one: run by ``make test-vm``.

No timing: an emulated machine has none. Each scenario goes on where the one before it ended.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cantools
import pytest
from host.cell import command_line, until

from .machine import CONFIG, PROGRAM, UNIT, done, ok
from .vcan import CHANNEL, Dump, error_frame, set_link
from .vm_cell import CAN_TEXT, DATABASES, write
from .vm_service import installed

PATIENCE_S = 60.0
OPERATOR = "can-operator"
CACHE = Path("/home/can-operator/.cache")
DATABASE = DATABASES / "manipulator.dbc"


class Peer:
    """The device: ``can_peer.py`` in a process of its own."""

    def __init__(self, folder):
        self._log = folder / "commands"
        self._log.touch()
        arguments = (CHANNEL, str(DATABASE), str(self._log))
        self.process = subprocess.Popen([sys.executable, str(Path(__file__).with_name("can_peer.py")), *arguments])

    def commands(self, since_s=0.0):
        """Voltage and count of each command that it got at or after `since_s` (CLOCK_MONOTONIC)."""
        rows = [line.split() for line in self._log.read_text().splitlines() if line.count(" ") == 2]
        return [(float(voltage_V), int(count)) for came_s, voltage_V, count in rows if float(came_s) >= since_s]

    def gets(self, number, since_s):
        """Wait for so many commands; their voltages."""
        until(lambda: len(self.commands(since_s)) >= number, "commands", PATIENCE_S)
        return [voltage_V for voltage_V, _ in self.commands(since_s)]

    @property
    def voltage_V(self):
        return self.commands()[-1][0]

    def end(self):
        self.process.kill()
        self.process.wait()


class PlayedDevice:
    """``micromanip simulate-device`` for the service's own configuration, as an operator runs it."""

    def __init__(self, folder):
        ok("useradd", "--create-home", "--groups", "micromanip", OPERATOR)
        shutil.copytree("/kept/micromanip", CACHE / "micromanip")
        ok("chown", "-R", f"{OPERATOR}:", str(CACHE))
        self._report, self._said = folder / "report", folder / "said"
        with self._report.open("w") as out, self._said.open("w") as err:
            self.process = subprocess.Popen(
                [PROGRAM, "simulate-device", str(CONFIG), "--watchdog", "10000", "--json"],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                cwd="/",
                env=os.environ | {"HOME": str(CACHE.parent), "XDG_CACHE_HOME": str(CACHE)},
                user=OPERATOR,
                group=OPERATOR,
                extra_groups=["micromanip"],
            )
        until(lambda: "READY" in self._said.read_text() or self.process.poll() is not None, self._said.read_text)
        assert self.process.poll() is None, self._said.read_text()

    def end(self):
        """Ctrl-C; what it reports."""
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(PATIENCE_S) == 0, self._said.read_text()
        return json.loads(self._report.read_text())


@pytest.fixture(scope="module")
def peer(tmp_path_factory):
    peer = Peer(tmp_path_factory.mktemp("peer"))
    yield peer
    peer.end()


@pytest.fixture(scope="module")
def service(peer, tmp_path_factory):
    """Installed and started once."""
    service = installed(write(tmp_path_factory.mktemp("cell"), "can.yaml", CAN_TEXT))
    shutil.copy(DATABASE, CONFIG.parent)
    service.since = f"{time.time():.6f}"
    yield service.start()
    service.release()
    done("systemctl", "stop", UNIT)


@pytest.fixture(scope="module")
def played(service, peer, tmp_path_factory):
    """It takes the place of the foreign device."""
    peer.end()
    device = PlayedDevice(tmp_path_factory.mktemp("played"))
    yield device
    device.process.kill()
    device.process.wait()


def link(service):
    return service.status_report()["links"]["can0"]


def clear_fault(service, code):
    """As an operator does; once its black box is on disk."""
    service.reach("FAULT")
    until(lambda: code in service.journal(), service.journal, PATIENCE_S)
    until(lambda: done(PROGRAM, "reset").returncode == 0, lambda: f"reset\n{service.journal()}")
    service.reach("READY")


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
    assert set(peer.gets(10, 0.0)) == {0.0}
    service.track()
    until(lambda: peer.voltage_V > 50, "voltage", PATIENCE_S)
    for step_s in (3600, -3600):
        ok("date", "--set", f"@{time.time() + step_s:.6f}")
        assert min(peer.gets(50, time.monotonic())) > 50
    assert service.state == "TRACKING"
    assert service.ring["rows"]["axis"]["strain_um"].max() > 45
    assert "WARNING" not in service.journal()
    now = link(service)
    assert (now["link"], now["outputs"], now["links"]) == ("up", "following", 1)
    assert now["counts"]["lost"] == now["counts"]["overflows"] == 0


def test_interface_down_is_a_fault_and_up_again_the_outputs_rest(service, peer):
    assert service.state == "TRACKING"
    set_link("down")
    until(lambda: service.state in ("RAMPING", "FAULT"), lambda: f"fault\n{service.journal()}", PATIENCE_S)
    until(lambda: "socketcan-vcan0: vcan0 is down; as root: " in service.journal(), service.journal, PATIENCE_S)
    up_s = time.monotonic()
    set_link("up")
    until(lambda: "driver can0: link up; its outputs stay at rest" in service.journal(), service.journal, PATIENCE_S)
    assert set(peer.gets(100, up_s)) == {0.0}
    assert service.state == "FAULT"
    clear_fault(service, "X-108")
    assert set(peer.gets(50, time.monotonic())) == {0.0}
    service.track()
    until(lambda: peer.voltage_V > 50, "voltage", PATIENCE_S)


def test_bus_off_is_a_fault_and_the_outputs_come_to_rest(service, peer):
    assert service.state == "TRACKING"
    before = link(service)["links"]
    ok("cansend", CHANNEL, error_frame(0x040))
    until(lambda: service.state in ("RAMPING", "FAULT"), lambda: f"fault\n{service.journal()}", PATIENCE_S)
    said = "link lost: bus-off on socketcan-vcan0: too many errors, "
    until(lambda: said in service.journal(), service.journal, PATIENCE_S)
    until(lambda: link(service)["links"] == before + 1, service.journal, PATIENCE_S)
    until(lambda: peer.voltage_V == 0.0, "outputs at rest", PATIENCE_S)
    clear_fault(service, "X-108")
    assert set(peer.gets(50, time.monotonic())) == {0.0}
    assert link(service)["counts"]["bus_off"] == 1
    service.track()
    until(lambda: peer.voltage_V > 50, "voltage", PATIENCE_S)


def test_played_device_takes_the_place_of_the_foreign_one(service, played):
    """It counts from the beginning, as a device does that was switched off and on."""
    until(lambda: link(service)["counts"]["restarts"] == 1, lambda: json.dumps(link(service)), PATIENCE_S)
    with Dump(40) as dump:
        sent = [frame[:6] for frame in dump.frames()]
    assert set(sent) == {"100##1", "101##1"}
    row = service.ring["rows"][service.ring["rows"]["cycle"].argmax()]["axis"]
    assert row["strain_um"][0] > 20  # the played piezo is out
    assert service.state == "TRACKING"


def test_stops_with_a_ramp_and_leaves_nothing_behind(service, played):
    voltages = cantools.database.load_file(DATABASE).get_message_by_name("Voltages")
    with Dump() as dump:
        ok("systemctl", "stop", UNIT)
        dump.end()
        commands = [bytes.fromhex(frame[6:]) for frame in dump.frames() if frame.startswith("100##1")]
    assert service.show("Result") == "success"
    sent_V = [voltages.decode(data)["voltage_x"] for data in commands]
    assert sent_V[0] > 50
    assert sent_V[-1] == 0.0
    assert any(0.5 < voltage_V < 50 for voltage_V in sent_V)
    assert not [entry for entry in Path("/proc").iterdir() if "micromanip.io.worker" in command_line(entry.name)]


def test_operator_probes_the_bus_and_sees_the_device(service, played):
    probe = (PROGRAM, "probe", str(CONFIG), "can0", "--json")
    seen = json.loads(ok("env", f"XDG_CACHE_HOME={CACHE}", *probe, user=OPERATOR))
    assert seen["device"] == "socketcan-vcan0"
    [answer] = seen["answers"]
    assert (answer["name"], answer["note"]) == ("message 0x101", "Sensors")
    assert answer["values"]["Status"] == 0
    report = played.end()["devices"]["can0"]
    assert report["received"] > 0
    assert report["not_understood"] == report["not_sent"] == 0
