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

from .bring_up import bring_to_op, bring_to_safeop
from .image import Image
from .link import Link
from .options import EthercatOptions
from .records import WHOLE

_LOOK_S, _FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.005, 0.05, 2.0


class Tender:
    """Of one context, a record in memory that the loop writes."""

    def __init__(self, options: EthercatOptions, image: Image, context: Any, period_ns: int) -> None:
        self._options, self._image, self._context, self._period_ns = options, image, context, period_ns
        self._said, self._cut_behind = "", WHOLE

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
                        turn_ns = bring_to_safeop(link, self._options, self._image, self._period_ns)
                        self._context["turn_ns"] = turn_ns
                    is_prepared = False
                    bring_to_op(link, self._options)
                self._context["bring_ups"] += 1
                wait.wait(_FIRST_PAUSE_S)
            except BusError as problem:
                self._tell(str(problem))
                wait.wait(pause_s)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)

    def _look_at_ring(self) -> None:
        """Say where it has been cut, and that it is whole again."""
        ring = self._context["ring"]
        behind = int(ring["cut_behind"])
        if not ring["present"] or behind == self._cut_behind:
            return
        self._cut_behind = behind
        near, far = self._options.interfaces
        ends = [f"interface {near}", *(f"terminal {name}" for name in self._options.terminals), f"interface {far}"]
        if behind == WHOLE:
            self._tell(f"ethercat {near}: the ring is whole again")
        else:
            self._tell(
                f"ethercat {near}: the ring is cut between {ends[behind]} and {ends[behind + 1]}: all terminals are "
                "reached from its two ends; mend it, a second cut would stop the cell"
            )

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
