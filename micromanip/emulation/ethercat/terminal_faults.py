"""Faults that are injected into the terminals of a line, and how they end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from micromanip.errors import UsageError
from micromanip.testbus.event_loop import EventLoop

from .faults import Absent, Clock, Cut, LeftOp, MailboxSilent, Order, Power, TerminalFault
from .line import Line


class TerminalFaults:
    """The faults of one line's terminals."""

    def __init__(self, loop: EventLoop, names: Sequence[str], line: Line, left_op: Callable[[], None]) -> None:
        """`names` are the terminals' in the order of `line`; `left_op` is called where one may have left OP."""
        self._loop, self._names, self._line, self._left_op = loop, names, line, left_op

    def befall(self, fault: TerminalFault | Cut) -> None:
        """Let it happen, and end when it says; UsageError where there is no such place."""
        if isinstance(fault, Cut):
            self._cut(fault)
            return
        if fault.terminal not in self._names:
            raise UsageError(f"fault {fault.kind}: there is no terminal {fault.terminal}: {', '.join(self._names)}")
        k = self._names.index(fault.terminal)
        application = self._line.applications[k]
        over: Callable[[], None] | None = None
        match fault:
            case Power():
                self._switch_off(k)
                over = partial(self._switch_on, k)
            case LeftOp():
                application.drop(fault.code)
            case Absent():
                application.be_absent()
                over = application.take_part
            case Clock():
                application.drift(fault.ppm, self._loop.now_ns())
                over = partial(self._put_right, k)
            case MailboxSilent():
                application.mailbox_silent = True
            case Order():
                if k + 1 == len(self._names):
                    raise UsageError(f"fault order: behind {fault.terminal} there is no terminal")
                self._swap(k)
                over = partial(self._swap, k)
        self._later(fault.for_s, over)

    def reboot(self, for_s: float) -> None:
        """All of them without power for so long."""
        for k in range(len(self._names)):
            self._switch_off(k)
            self._later(for_s, partial(self._switch_on, k))

    def clear(self) -> None:
        """End all of it."""
        self._line.cuts.clear()
        self._line.relink()
        for k, application in enumerate(self._line.applications):
            application.take_part()
            application.mailbox_silent = False
            self._put_right(k)
            if not self._line.controllers[k]["powered"]:
                self._switch_on(k)

    def _cut(self, fault: Cut) -> None:
        if fault.behind > len(self._names):
            raise UsageError(f"fault cut: behind {fault.behind} terminals, but there are {len(self._names)}")
        self._line.cuts.add(fault.behind)
        self._line.relink()
        self._later(fault.for_s, partial(self._mend, fault.behind))

    def _mend(self, behind: int) -> None:
        self._line.cuts.discard(behind)
        self._line.relink()

    def _swap(self, k: int) -> None:
        self._line.swap(k, self._loop.now_ns())
        self._line.relink()
        self._left_op()

    def _switch_off(self, k: int) -> None:
        self._line.controllers[k]["powered"] = 0
        self._line.relink()
        self._left_op()

    def _switch_on(self, k: int) -> None:
        self._line.applications[k].switch_on(self._loop.now_ns())
        self._line.relink()

    def _put_right(self, k: int) -> None:
        self._line.applications[k].drift(0.0, self._loop.now_ns())

    def _later(self, for_s: float | None, over: Callable[[], None] | None) -> None:
        if for_s is not None and over is not None:
            self._loop.call_at(self._loop.now_ns() + round(for_s * 1e9), over)
