"""The service on a PREEMPT_RT kernel, in an emulated machine: run by ``make test-vm``. Rights and limits, no timing."""

import os
import re
from pathlib import Path

import pytest

from .machine import PROGRAM, UNIT, ok
from .vm_cell import TEXT
from .vm_service import installed

# Opens what drivers open, in the very sandbox of the unit.
OPEN_DEVICES = (
    "import os, socket; "
    "socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).bind(('vcan0',)); "
    "os.open('/dev/ttyS0', os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)"
)


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """Installed and started once: an emulated processor takes a minute to import numba."""
    file = tmp_path_factory.mktemp("cell") / "cell.yaml"
    file.write_text(TEXT)
    service = installed(file, f'ExecStartPre=/opt/micromanip/bin/python -c "{OPEN_DEVICES}"')
    yield service.start()
    service.release()


def test_kernel_is_preempt_rt():
    assert "PREEMPT_RT" in os.uname().version
    assert Path("/sys/kernel/realtime").read_text().strip() == "1"


def test_loop_has_fifo_locked_memory_and_its_cpu_without_being_root(service):
    assert service.state == "READY"
    loop = Path(f"/proc/{service.loop}")
    status = dict(line.split(":\t", 1) for line in (loop / "status").read_text().splitlines())
    assert loop.stat().st_uid == int(ok("id", "-u", "micromanip")) != 0
    assert int(status["CapEff"], 16) == int(status["CapBnd"], 16) == 0
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


def test_arms_and_stops_with_a_ramp(service):
    ok(PROGRAM, "arm")
    service.reach("TRACKING")
    assert service.ring["rows"]["axis"]["voltage_V"].max() > 50
    ok("systemctl", "stop", UNIT)
    assert service.show("Result") == "success"
    rows = service.ring["rows"]
    assert rows[rows["cycle"].argmax()]["axis"]["voltage_V"][0] == 0.0
