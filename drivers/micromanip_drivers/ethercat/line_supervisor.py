"""A thread of the loop's process that brings the line to OP, at the start and whenever a slave has left it.

The loop is compiled and holds no lock of Python's: it goes on sending the safe values meanwhile. A line that is there
again is at rest: its outputs follow the loop only after `reset` and `arm`, which is the gate's to see to.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from typing import Any

from micromanip.driver import BusError
from micromanip.driver.wire import ANSWERS, RESTING

from .bring_up import Clocks, bring_to_op, bring_to_safeop
from .image import Image
from .link import Link
from .options import EthercatOptions
from .records import WHOLE
from .scan import FIRST_STATION

_LOOK_S, _FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.005, 0.05, 2.0


class LineSupervisor:
    """Of one context, a record in memory that the loop writes."""

    def __init__(self, options: EthercatOptions, image: Image, context: Any, period_ns: int, clocks: Clocks) -> None:
        self._options, self._image, self._context, self._period_ns = options, image, context, period_ns
        self._said, self._cut_behind = "", WHOLE
        self._take(clocks)

    def start(self) -> None:
        """Look after the line until the context is closed; the process need not wait for it."""
        threading.Thread(target=self._look_after, name="ethercat", daemon=True).start()

    def _look_after(self) -> None:
        _be_ordinary()
        wait, pause_s, is_prepared = threading.Event(), _FIRST_PAUSE_S, True
        while not self._context["closed"]:
            wait.wait(_LOOK_S)
            self._look_at_ring()
            if not self._is_needed():
                pause_s = _FIRST_PAUSE_S
                continue
            try:
                with Link(*self._options.interfaces) as link:
                    if not is_prepared:
                        self._take(bring_to_safeop(link, self._options, self._image, self._period_ns))
                    is_prepared = False
                    bring_to_op(link, self._options)
                self._context["bring_ups"] += 1
                wait.wait(_FIRST_PAUSE_S)
            except BusError as problem:
                self._tell(str(problem))
                wait.wait(pause_s)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)

    def _take(self, clocks: Clocks) -> None:
        """What a frame takes from the first clock on, that is known: through a ring it goes one way."""
        self._clocks, self._halves = clocks, [list(clocks.delay_ns)]
        self._context["turn_ns"], self._context["ring"]["way_ns"] = clocks.turn_ns, clocks.turn_ns // 2

    def _look_at_ring(self) -> None:
        """Say where it has been cut, and that it is whole again; clocks behind a cut count from the first of them."""
        ring = self._context["ring"]
        behind = int(ring["cut_behind"])
        if not ring["present"] or behind == self._cut_behind:
            return
        self._cut_behind = behind
        near, far = self._options.interfaces
        ends = [f"interface {near}", *(f"terminal {name}" for name in self._options.terminals), f"interface {far}"]
        led = self._led(behind)
        if behind == WHOLE:
            self._tell(f"ethercat {near}: the ring is whole again")
        else:
            alone = f"; the clocks behind the cut follow that of {ends[behind + 1]}, which has no reference"
            self._tell(
                f"ethercat {near}: the ring is cut between {ends[behind]} and {ends[behind + 1]}: all terminals are "
                f"reached from its two ends; mend it, a second cut would stop the cell{alone if led else ''}"
            )

    def _led(self, behind: int) -> bool:
        """Let the clocks on either side of a cut follow the first there; whether that leaves any without the time."""
        stations = [FIRST_STATION + k for k in range(len(self._options.terminals))]
        is_split = self._options.clocks and 0 < behind < len(stations)
        halves = [stations[:behind], stations[behind:]] if is_split else [stations]
        if self._options.clocks and halves != self._halves:
            with contextlib.suppress(BusError), Link(*self._options.interfaces) as link:  # it may be cut anew just now
                for half in halves:
                    self._clocks.follow(link, half)
                self._halves = halves
        return is_split

    def _is_needed(self) -> bool:
        """Whether the loop sends safe values in vain."""
        gate = self._context["gate"]
        in_vain = gate["state"] == RESTING and gate["answers"] < ANSWERS and gate["unanswered_in_a_row"] > ANSWERS
        return bool(self._context["opened"] and in_vain)

    def _tell(self, what: str) -> None:
        """A line for people, once: the loop's process passes on what it writes."""
        if what != self._said:
            sys.stderr.write(f"{what}\n")
            sys.stderr.flush()
        self._said = what


def _be_ordinary() -> None:
    """Whoever has started this thread may be urgent, or keep to the loop's CPU."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    with contextlib.suppress(OSError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
