"""What ran on the loop's CPU while it was late, as the kernel's own trace (ftrace) has it.

The trace goes into an instance of its own: nobody else's is touched, and it is gone with this process.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

_FOLDER = Path("/sys/kernel/tracing")
_EVENTS = ("sched/sched_switch", "irq/irq_handler_entry", "irq/irq_handler_exit", "irq/softirq_entry",
           "irq/softirq_exit", "irq_vectors")  # fmt: skip
_BUFFER_KB = 1024
"""Half a second of a loop at 10 kHz."""
_LINE = re.compile(r"\s(?P<s>\d+)\.(?P<us>\d{6}): (?P<event>\w+): (?P<rest>.*)$")
_SWITCH = re.compile(r"prev_pid=(?P<prev>\d+) .* ==> next_comm=(?P<comm>.*) next_pid=(?P<next>\d+) ")
_LAST_WORD = re.compile(r"(?:name|action)=(\S+?)\]?$")
UNSEEN = "nothing that the kernel saw: the hypervisor, or the hardware"
IDLE = "the CPU was idle, and woken late"


@dataclass(frozen=True)
class Event:
    """One line of the trace; `us` of CLOCK_MONOTONIC."""

    us: int
    name: str
    rest: str


@dataclass(frozen=True)
class LateCycle:
    """One cycle that came late: when it was due, by how much it was late, and what ran instead, the longest first."""

    due_ns: int
    lateness_us: float
    causes: tuple[tuple[str, int], ...]
    """Cause and microseconds."""


class Trace:
    """The events of one CPU while it is open."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def events(self, cpu: int) -> list[Event]:
        """What the buffer of `cpu` holds, oldest first."""
        return list(parsed((self._folder / f"per_cpu/cpu{cpu}/trace").read_text(errors="replace").splitlines()))


def why_not(folder: Path = _FOLDER) -> str | None:
    """Why nothing can be traced here, with what would mend it; None where it can."""
    if not (folder / "instances").is_dir():
        return (
            "the kernel's trace is not mounted, or not for this user: sudo mount -t tracefs nodev /sys/kernel/tracing"
        )
    if not os.access(folder / "instances", os.W_OK):
        return "the kernel's trace is root's: run system check with sudo to see what made the loop late"
    return None


@contextlib.contextmanager
def traced(cpu: int, folder: Path = _FOLDER) -> Iterator[Trace]:
    """Trace `cpu`. Raises OSError where the kernel refuses."""
    instance = folder / "instances" / f"micromanip-check-{os.getpid()}"
    instance.mkdir()
    try:
        for name, value in (
            ("tracing_on", "0"),
            ("trace_clock", "mono"),
            ("buffer_size_kb", str(_BUFFER_KB)),
            ("tracing_cpumask", f"{1 << cpu:x}"),
        ):
            (instance / name).write_text(value)
        for event in _EVENTS:
            if (switch := instance / "events" / event / "enable").exists():  # vectors are those of x86
                switch.write_text("1")
        (instance / "tracing_on").write_text("1")
        yield Trace(instance)
    finally:
        with contextlib.suppress(OSError):
            (instance / "tracing_on").write_text("0")
        instance.rmdir()


def parsed(lines: Iterable[str]) -> Iterator[Event]:
    """The events among lines of a trace; comments and what is no event are passed over."""
    for line in lines:
        if not line.startswith("#") and (found := _LINE.search(line)):
            yield Event(int(found["s"]) * 1_000_000 + int(found["us"]), found["event"], found["rest"])


def explained(events: Iterable[Event], process: int, due_ns: int, late_ns: int, spin_ns: int) -> LateCycle:
    """What kept `process` from its cycle: from when it was to be woken, `spin_ns` early, to when it noticed.

    What the loop itself did before the cycle was due is left out; after that it is what nobody saw.
    """
    due, woken, noticed = due_ns // 1000, (due_ns - spin_ns) // 1000, (due_ns + late_ns) // 1000
    spent: Counter[str] = Counter()
    for begin, end, who in _stretches(events, process, noticed):
        begin = max(begin, due if who == UNSEEN else woken)
        if begin < min(end, noticed):
            spent[who] += min(end, noticed) - begin
    return LateCycle(due_ns, late_ns * 1e-3, tuple(spent.most_common()))


def _stretches(events: Iterable[Event], process: int, until: int) -> Iterator[tuple[int, int, str]]:
    """Begin, end (us) and what ran then; before the first switch nothing is known."""
    at, task, inside = None, "", []
    for event in events:
        if event.us > until:
            break
        found = _SWITCH.search(event.rest) if event.name == "sched_switch" else None
        if at is not None:
            yield at, event.us, inside[-1] if inside else task
        if found:
            own, idle = int(found["next"]) == process, found["next"] == "0"
            task = UNSEEN if own else IDLE if idle else f"{found['comm']} [{found['next']}]"
        if found or at is not None:
            at = event.us
        if event.name.endswith("_entry"):
            inside.append(_called(event))
        elif event.name.endswith("_exit") and inside:
            inside.pop()
    if at is not None:
        yield at, until, inside[-1] if inside else task


def _called(event: Event) -> str:
    kind = event.name.removesuffix("_entry")
    named = _LAST_WORD.search(event.rest)
    if kind in ("irq_handler", "softirq") and named:
        return f"{'interrupt' if kind == 'irq_handler' else 'softirq'} {named[1]}"
    return f"interrupt {kind}"
