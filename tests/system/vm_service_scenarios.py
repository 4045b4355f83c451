"""The whole service on PREEMPT_RT and SocketCAN, with a foreign device, then a played one: run by the campaign ``vm``.

Rights, limits and what follows what; no timing: an emulated machine has none. Each scenario goes on where the one
before it ended, for a start takes an emulated processor minutes.
"""

import itertools
import os
import re
import time
from pathlib import Path

import cantools
import pytest

from campaigns.running_controller import command_line, until
from tests.cells import rows_of

from .can_devices import DATABASE, PATIENCE_S, EmulatedDevice, ForeignDevice
from .machine import PROGRAM, UNIT, done, ok
from .vcan import Dump, set_link
from .vm_cell import write
from .vm_service import installed


@pytest.fixture(scope="module")
def peer(tmp_path_factory):
    peer = ForeignDevice(tmp_path_factory.mktemp("peer"))
    yield peer
    peer.end()


@pytest.fixture(scope="module")
def service(peer, tmp_path_factory):
    """Installed and started once."""
    service = installed(write(tmp_path_factory.mktemp("cell") / "cell.yaml"))
    service.since = f"{time.time():.6f}"
    yield service.start()
    service.release()
    done("systemctl", "stop", UNIT)


@pytest.fixture(scope="module")
def played(service, peer, tmp_path_factory):
    """It takes the place of the foreign device."""
    peer.end()
    device = EmulatedDevice(tmp_path_factory.mktemp("played"))
    yield device
    device.process.kill()
    device.process.wait()


def link(service):
    return service.status_report()["links"]["can0"]


def says(service, text):
    until(lambda: text in service.journal(), lambda: f"{text!r}\n{service.journal()}", PATIENCE_S)


def falls(service):
    until(lambda: service.state in ("RAMPING", "FAULT"), lambda: f"fault\n{service.journal()}", PATIENCE_S)


def clear_lost_link(service):
    """As an operator does; once the trip's black box is on disk."""
    service.reach("FAULT")
    says(service, "X-108")
    until(lambda: done(PROGRAM, "reset").returncode == 0, lambda: f"reset\n{service.journal()}")
    service.reach("READY")


def track(service, peer):
    service.track()
    until(lambda: peer.voltage_V > 50, "voltage", PATIENCE_S)


def rights_of(pid):
    """The lines of /proc/PID/status, of a process that has no rights but those of its user, who is not root."""
    status = dict(line.split(":\t", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    assert Path(f"/proc/{pid}").stat().st_uid == int(ok("id", "-u", "micromanip")) != 0
    assert int(status["CapEff"], 16) == int(status["CapBnd"], 16) == 0
    return status


def test_kernel_is_preempt_rt():
    assert "PREEMPT_RT" in os.uname().version
    assert Path("/sys/kernel/realtime").read_text().strip() == "1"


def test_loop_has_fifo_locked_memory_and_its_cpu_without_being_root(service):
    assert service.state == "READY"
    status, loop = rights_of(service.loop), Path(f"/proc/{service.loop}")
    assert os.sched_getscheduler(service.loop) == os.SCHED_FIFO
    assert os.sched_getparam(service.loop).sched_priority == 80
    assert os.sched_getaffinity(service.loop) == {1}
    assert 1 not in os.sched_getaffinity(service.host)
    assert int(status["VmLck"].split()[0]) > 100_000  # kB: interpreter, compiled code and shared memory
    assert "/dev/cpu_dma_latency" in [str(link.readlink()) for link in (loop / "fd").iterdir()]
    assert "WARNING" not in service.journal()
    limits = (loop / "limits").read_text()
    assert re.search(r"Max realtime priority +99 +99 ", limits)
    assert re.search(r"Max locked memory +unlimited +unlimited ", limits)


def test_worker_has_fifo_below_the_loop_and_leaves_its_cpu_without_being_root(service):
    [worker] = [pid for pid in service.processes if "micromanip.bus.worker" in command_line(pid)]
    rights_of(worker)
    assert os.sched_getscheduler(worker) == os.SCHED_FIFO
    assert os.sched_getparam(worker).sched_priority == 70
    assert 1 not in os.sched_getaffinity(worker)


def test_moves_a_foreign_device_and_a_stepped_wall_clock_is_nothing(service, peer):
    assert set(peer.gets(10, 0.0)) == {0.0}
    track(service, peer)
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
    falls(service)
    says(service, "socketcan-vcan0: vcan0 is down; as root: ")
    last_V, up_s = peer.voltage_V, time.monotonic()
    set_link("up")
    says(service, "driver can0: link up; its outputs stay at rest")
    led_V = peer.gets(100, up_s)  # of the ramp of 25 values those that this device is back in time for
    assert [last_V, *led_V] == sorted([last_V, *led_V], reverse=True)
    assert max(before - after for before, after in itertools.pairwise(led_V)) < 0.1 * last_V
    assert set(led_V[-50:]) == {0.0}
    assert service.state == "FAULT"
    clear_lost_link(service)
    assert set(peer.gets(50, time.monotonic())) == {0.0}
    track(service, peer)


def test_silent_device_is_a_fault_and_the_played_one_takes_its_place(service, request):
    assert service.state == "TRACKING"
    request.getfixturevalue("played")
    falls(service)
    says(service, "link lost: socketcan-vcan0: nothing of Sensors came for ")
    until(lambda: link(service)["link"] == "up", service.journal)
    clear_lost_link(service)
    service.track()
    with Dump(40) as dump:
        sent = [frame[:6] for frame in dump.frames()]
    assert set(sent) == {"100##1", "101##1"}
    until(lambda: rows_of(service.ring)["axis"]["voltage_V"][-1, 0] > 50, "voltage", PATIENCE_S)
    until(lambda: rows_of(service.ring)["axis"]["strain_um"][-1, 0] > 20, "the played piezo", PATIENCE_S)


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
    assert rows_of(service.ring)["axis"]["voltage_V"][-1, 0] == 0.0
    assert not [entry for entry in Path("/proc").iterdir() if "micromanip.bus.worker" in command_line(entry.name)]
