"""Two loops on one CPU: the second says who has it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from micromanip.host.realtime import cpu_conflicts

HELD = "import os; os.sched_setaffinity(0, {%d}); %s; print(flush=True); input()"


@pytest.fixture
def pinned():
    """Starts a process that is pinned to a CPU, its last argument a module's name, after one more call."""
    started = []

    def start(cpu, name, more="0"):
        command = [sys.executable, "-S", "-c", HELD % (cpu, more), name]
        started.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE))
        return started[-1].pid if started[-1].stdout.readline() == b"\n" else None

    yield start
    for each in started:
        each.communicate(b"\n")


def told(cpu, pid, own=0):
    return [text for text in cpu_conflicts(cpu, own) if f"process {pid}" in text]


@pytest.mark.live  # processes
def test_the_loop_of_another_cell_is_named_by_its_command(pinned):
    cpu = max(os.sched_getaffinity(0))
    loop, other = pinned(cpu, "micromanip.host.loop_process"), pinned(cpu, "somebody")
    (found,) = told(cpu, loop)
    assert found.startswith(f"the loop of another cell, process {loop}, is pinned to it, too: `")
    assert Path("/proc/self/cmdline").read_bytes().split(b"\0")[0].decode() in found, "who started it"
    assert told(cpu, other) == [], "an ordinary process gives way"
    assert told(cpu, loop, own=loop) == told(cpu + 1, loop) == list(cpu_conflicts(None, 0)) == []
