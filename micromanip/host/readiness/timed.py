"""The timed run: the loop at rest and under load.

The load is ordinary work on every CPU, as a cell's computer may have it: hashing, copying, files, short processes.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from micromanip.errors import CheckFailed
from micromanip.settings.schema.model import Loop

from .loop_run import LoopRun, run_in_ready, simulated_cell

_WORK = """
import hashlib, os, subprocess, sys, tempfile, time
parent, end = os.getppid(), time.monotonic() + float(sys.argv[1])
block = bytearray(32 << 20)
while time.monotonic() < end and os.getppid() == parent:
    hashlib.sha256(block[: 4 << 20]).digest()
    bytes(block)
    with tempfile.TemporaryFile() as file:
        file.write(block[: 1 << 20])
        os.fsync(file.fileno())
    subprocess.run(["true"])
"""


@contextlib.contextmanager
def loaded(longest_s: float) -> Iterator[int]:
    """Load while it is entered, by as many processes as there are CPUs; their number.

    They end by themselves with this process, or after `longest_s`.
    """
    count = len(os.sched_getaffinity(0))
    command = [sys.executable, "-I", "-S", "-c", _WORK, str(longest_s)]
    workers = [subprocess.Popen(command, stdin=subprocess.DEVNULL) for _ in range(count)]
    try:
        yield count
    finally:
        for worker in workers:
            worker.kill()
        for worker in workers:
            worker.wait()


_STARTING_S = 120.0
"""What the load lasts at most beyond the run: the loop may have to be compiled."""
_CONTROLLERS = ("micromanip.host.loop_process", "micromanip.bus.worker_process")


@dataclass(frozen=True)
class Timed:
    """Everything that was measured."""

    seconds: float
    load_processes: int
    at_rest: LoopRun
    under_load: LoopRun

    @property
    def keeps_its_deadlines(self) -> bool:
        """No deadline was missed by a period, neither at rest nor under load."""
        return self.at_rest.overruns == 0 and self.under_load.overruns == 0

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "seconds_each": self.seconds,
            "load_processes": self.load_processes,
            "at_rest": self.at_rest.document(),
            "under_load": self.under_load.document(),
        }


def refuse_beside_a_controller(root: Path = Path("/")) -> None:
    """Raises CheckFailed where a controller runs on this machine: a process at its priority would hold it up."""
    for process in sorted((root / "proc").glob("[0-9]*")):
        with contextlib.suppress(OSError):
            words = (process / "cmdline").read_bytes().decode(errors="replace").split("\0")
            if any(word in _CONTROLLERS for word in words):
                raise CheckFailed(
                    f"a controller runs here (process {process.name}): the timed run would hold its loop up. Stop it "
                    "first, or look at the settings only: micromanip system check --no-run"
                )


def measure(loop: Loop, seconds: float, progress: Callable[[str], None]) -> Timed:
    """Run the loop, `seconds` at rest and under load; `progress` hears what goes on.

    Raises CheckFailed beside a running controller, and what `Controller.start` does.
    """
    refuse_beside_a_controller()
    cell = simulated_cell(loop)
    progress(f"the loop at rest, {seconds:g} s")
    quiet = asyncio.run(run_in_ready(cell, seconds))
    with loaded(2 * seconds + _STARTING_S) as processes:
        progress(f"the loop beside {processes} busy processes, {seconds:g} s")
        busy = asyncio.run(run_in_ready(cell, seconds))
    return Timed(seconds, processes, quiet, busy)
