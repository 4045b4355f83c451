"""The timed run: the loop at rest and under load, cyclictest beside it, and what made the loop late.

The load is ordinary work on every CPU, as a cell's computer may have it: hashing, copying, files, short processes.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from micromanip.errors import CheckFailed, DeviceUnavailable
from micromanip.host.statistics import durations
from micromanip.settings.check import Prepared
from micromanip.settings.schema.model import Loop

from . import cyclictest, tracing
from .counters import Counters
from .finding import Machine
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


_PERCENTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999, "p99_99": 0.9999, "max": 1.0}
_MOST_EXPLAINED = 8
_LATE_NS = 20_000
"""Less is the kernel's ordinary way to a process, and not looked into."""
_STARTING_S = 120.0
"""What the load lasts at most beyond the run: the loop may have to be compiled."""
_CONTROLLERS = ("micromanip.host.loop_process", "micromanip.bus.worker_process")


@dataclass(frozen=True)
class Condition:
    """The loop, and where there is one cyclictest, in turns on the same CPU; counts by lateness (ns)."""

    loop: LoopRun
    reference: dict[int, int] | None


@dataclass(frozen=True)
class Timed:
    """Everything that was measured; `not_measured` says what was not, and why."""

    seconds: float
    load_processes: int
    at_rest: Condition
    under_load: Condition
    counters: Counters
    clock_gaps: dict[str, float] | None
    late_cycles: tuple[tracing.LateCycle, ...]
    not_measured: tuple[str, ...]

    @property
    def keeps_its_deadlines(self) -> bool:
        """No deadline was missed by a period, neither at rest nor under load."""
        return self.at_rest.loop.overruns == 0 and self.under_load.loop.overruns == 0

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "seconds_each": self.seconds,
            "load_processes": self.load_processes,
            "at_rest": condition_document(self.at_rest),
            "under_load": condition_document(self.under_load),
            "interrupts_under_load": self.counters.interrupts,
            "counters_under_load": self.counters.others,
            "clock_gaps": self.clock_gaps,
            "late_cycles": [asdict(late) for late in self.late_cycles],
            "not_measured": list(self.not_measured),
        }


def condition_document(condition: Condition) -> dict[str, Any]:
    """Durations in ns, of the loop and of cyclictest."""
    loop, counts = condition.loop, condition.reference
    return {
        "cycles": loop.cycles,
        "overruns": loop.overruns,
        "lateness_ns": durations(loop.lateness, loop.lateness_max_ns),
        "compute_ns": durations(loop.compute, loop.compute_max_ns),
        "cyclictest_ns": None
        if counts is None
        else {name: cyclictest.percentile(counts, share) for name, share in _PERCENTILES.items()},
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


def measure(loop: Loop, cpu: int, seconds: float, progress: Callable[[str], None]) -> Timed:
    """Run everything on `cpu`, `seconds` each; `progress` hears what goes on.

    Raises CheckFailed beside a running controller, and what `Controller.start` does.
    """
    refuse_beside_a_controller()
    cell, machine = simulated_cell(loop), Machine()
    missing: list[str] = []
    progress(f"the loop at rest, {seconds:g} s")
    quiet = asyncio.run(run_in_ready(cell, seconds))
    reference = _cyclictest(loop, cpu, seconds, "at rest", progress, missing)
    with loaded(4 * seconds + _STARTING_S) as processes:
        progress(f"the loop beside {processes} busy processes, {seconds:g} s")
        watched = _Watched(machine, cpu)
        busy = asyncio.run(run_in_ready(cell, seconds, watched))
        counters = watched.since()
        busy_reference = _cyclictest(loop, cpu, seconds, "under load", progress, missing)
        late = _traced(cell, cpu, seconds, progress, missing)
    gaps = _clock_gaps(loop, cpu, seconds, progress, missing)
    at_rest, under_load = Condition(quiet, reference), Condition(busy, busy_reference)
    return Timed(seconds, processes, at_rest, under_load, counters, gaps, late, tuple(missing))


class _Watched:
    """Reads the kernel's counters at the beginning of a run, and with each look at its rows."""

    def __init__(self, machine: Machine, cpu: int) -> None:
        self._machine, self._cpu = machine, cpu
        self._taken: list[Counters] = []

    def __call__(self, process: int, _rows: Any) -> None:
        now = Counters.taken(self._machine, self._cpu, process)
        self._taken = [*self._taken[:1], now]

    def since(self) -> Counters:
        """From the beginning to the last look."""
        return self._taken[-1].since(self._taken[0])


def _cyclictest(
    loop: Loop, cpu: int, seconds: float, when: str, progress: Callable[[str], None], missing: list[str]
) -> dict[int, int] | None:
    try:
        cyclictest.require_cyclictest()
        progress(f"cyclictest {when}, {seconds:g} s")
        return cyclictest.measure(loop.period_ns, loop.priority, cpu, seconds)
    except DeviceUnavailable as reason:
        if str(reason) not in missing:
            missing.append(str(reason))
        return None


def _clock_gaps(
    loop: Loop, cpu: int, seconds: float, progress: Callable[[str], None], missing: list[str]
) -> dict[str, float] | None:
    progress(f"a process that only watches the clock, {seconds:g} s")
    command = [sys.executable, "-P", "-m", "micromanip.host.readiness.clock_gaps"]
    command += [str(cpu), str(loop.priority), str(seconds)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=seconds * 3 + 60)
    if done.returncode:
        missing.append(f"gaps of the clock: {done.stderr.strip()}")
        return None
    found: dict[str, float] = json.loads(done.stdout)
    return found


def _traced(
    cell: Prepared, cpu: int, seconds: float, progress: Callable[[str], None], missing: list[str]
) -> tuple[tracing.LateCycle, ...]:
    """The latest cycles of a run of its own: the trace itself costs the loop some time."""
    if (reason := tracing.why_not()) is not None:
        missing.append(f"what made the loop late: {reason}")
        return ()
    progress(f"the loop beside them, and the kernel's trace of CPU {cpu}, {seconds:g} s")
    found: list[tracing.LateCycle] = []
    spin_ns = round(cell.configuration.loop.spin_us * 1e3)
    try:
        with tracing.traced(cpu) as trace:

            def seen(process: int, rows: Any) -> None:
                for due_ns, late_ns in _later_than(rows, found, cell.configuration.loop.period_ns):
                    found.append(tracing.explained(trace.events(cpu), process, due_ns, late_ns, spin_ns))

            asyncio.run(run_in_ready(cell, seconds, seen))
    except OSError as problem:
        missing.append(f"what made the loop late: the kernel's trace refuses: {problem.strerror}")
    return tuple(sorted(found, key=lambda late: -late.lateness_us)[:_MOST_EXPLAINED])


def _later_than(rows: Any, found: list[tracing.LateCycle], period_ns: int) -> Iterator[tuple[int, int]]:
    """Due time and lateness (ns) of the latest of new `rows`, where it is among the latest of all up to now."""
    if not len(rows):
        return
    row = rows[int(rows["lateness_ns"].argmax())]
    late_ns = int(row["lateness_ns"])
    before = sorted((late.lateness_us for late in found), reverse=True)[:_MOST_EXPLAINED]
    if late_ns >= _LATE_NS and (len(before) < _MOST_EXPLAINED or late_ns * 1e-3 > before[-1]):
        yield int(row["time_ns"]) - (int(row["periods"]) - 1) * period_ns, late_ns
