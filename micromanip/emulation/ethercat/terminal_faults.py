"""What befalls the terminals themselves: ``{"inject": "power", "terminal": "gauge", "for_s": 1}``.

Whatever befalls frames is of any line (``emulation/line/faults.py``), but for wrong bits: a network card drops such a
frame, so say ``drop``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from micromanip.bus.ethercat.al_states import WATCHDOG
from micromanip.emulation.line.faults import LineFault
from micromanip.errors import UsageError
from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.fault import validated

from .line import Line


class TerminalFault(LineFault):
    """A fault of one terminal."""

    terminal: str = Field(description="Its name in the configuration.")


class OneOf(TerminalFault):
    """One that needs no more than its name."""

    kind: Literal["power", "absent", "order"]


class LeftOp(TerminalFault):
    """It leaves OP, once."""

    kind: Literal["left_op"]
    code: Annotated[int, Field(strict=True, ge=1, le=0xFFFF)] = WATCHDOG


class Clock(TerminalFault):
    """Its clock drifts."""

    kind: Literal["clock"]
    ppm: Annotated[float, Field(strict=True, ge=-1000, le=1000)]


class Cut(LineFault):
    """The cable is cut; plugged in again when it ends."""

    kind: Literal["cut"]
    behind: Annotated[int, Field(strict=True, ge=0, description="So many terminals.")]


KINDS = ("power", "left_op", "absent", "order", "clock", "cut")
_ANY: TypeAdapter[TerminalFault | Cut] = TypeAdapter(
    Annotated[OneOf | LeftOp | Clock | Cut, Field(discriminator="kind")]
)


def parsed(document: object) -> TerminalFault | Cut:
    """The fault that a mapping describes. Raises UsageError with the first thing that is wrong with it."""
    return validated(_ANY, document)


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
        if isinstance(fault, LeftOp):
            application.drop(fault.code)
        elif isinstance(fault, Clock):
            application.drift(fault.ppm, self._loop.now_ns())
            over = partial(self._put_right, k)
        elif fault.kind == "power":
            self._switch_off(k)
            over = partial(self._switch_on, k)
        elif fault.kind == "absent":
            application.be_absent()
            over = application.take_part
        else:
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
