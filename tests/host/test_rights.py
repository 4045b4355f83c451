"""Without real-time rights: the simulation says so loudly, hardware limits refuse."""

import os
import shutil

import pytest

from tests.cells import SLOW

RIGHTS = "-sys_nice,-ipc_lock,-sys_resource"

if os.geteuid() == 0:
    WITHOUT_RIGHTS = ("setpriv", f"--bounding-set={RIGHTS}", f"--inh-caps={RIGHTS}", "prlimit", "--memlock=65536:65536")
else:
    WITHOUT_RIGHTS = ("prlimit", "--memlock=65536:65536")
# the nice value, too: what runs the tests may itself go before ordinary work, and may leave that to whom it starts
WITHOUT_RIGHTS += ("--rtprio=0:0", "--nice=0:0", "nice", "--adjustment=19")

pytestmark = pytest.mark.skipif(
    any(shutil.which(tool) is None for tool in WITHOUT_RIGHTS if tool in ("setpriv", "prlimit")),
    reason="setpriv and prlimit (util-linux) take the rights away, and are not installed",
)


def warnings(cell):
    return [line for line in cell.said.splitlines() if line.startswith("WARNING")]


def test_hardware_limits_refuse(run):
    cell = run(SLOW, prefix=WITHOUT_RIGHTS)
    assert cell.wait() == 77
    *before, line = cell.said.splitlines()
    assert before == warnings(cell)
    assert line.startswith("micromanip: no SCHED_FIFO: ")
    assert "memory not locked: " in line
    assert "READY" not in cell.said
    assert cell.report.keys() == {"error", "exit_code"}
    assert cell.left == []
