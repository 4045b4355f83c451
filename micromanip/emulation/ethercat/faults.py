"""What befalls the terminals themselves: ``{"inject": "power", "terminal": "gauge", "for_s": 1}``.

    power       a terminal is without power for a time, and with it all behind it; then it begins with INIT
    left_op     it falls back to SAFEOP, with an AL status ``code``
    absent      it takes no part in the process data: the working counter is wrong
    mailbox     its mailbox takes mails and gives none
    order       it has changed places with the one behind it
    clock       its clock gains `ppm` from now on
    cut         the cable is cut behind the first `behind` terminals, 0: in front of them all; has no `terminal`

Whatever befalls frames is of any line (``emulation/line/faults.py``), but for wrong bits: a network card drops such a
frame, so say ``drop``.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from micromanip.bus.ethercat.al_states import WATCHDOG
from micromanip.emulation.line.fault import LineFault
from micromanip.testbus.fault import validated


class TerminalFault(LineFault):
    """A fault of one terminal."""

    terminal: str = Field(description="Its name in the configuration.")


class Power(TerminalFault):
    """Without power for a time."""

    kind: Literal["power"]


class LeftOp(TerminalFault):
    """It leaves OP, once."""

    kind: Literal["left_op"]
    code: Annotated[int, Field(strict=True, ge=1, le=0xFFFF)] = WATCHDOG


class Absent(TerminalFault):
    """It takes no part in the process data."""

    kind: Literal["absent"]


class MailboxSilent(TerminalFault):
    """Its mailbox does not answer."""

    kind: Literal["mailbox"]


class Order(TerminalFault):
    """It has changed places with the next."""

    kind: Literal["order"]


class Clock(TerminalFault):
    """Its clock drifts."""

    kind: Literal["clock"]
    ppm: Annotated[float, Field(strict=True, ge=-1000, le=1000)]


class Cut(LineFault):
    """The cable is cut; plugged in again when it ends."""

    kind: Literal["cut"]
    behind: Annotated[int, Field(strict=True, ge=0, description="So many terminals.")]


KINDS = ("power", "left_op", "absent", "mailbox", "order", "clock", "cut")
_ANY: TypeAdapter[TerminalFault | Cut] = TypeAdapter(
    Annotated[
        Power | LeftOp | Absent | MailboxSilent | Order | Clock | Cut,
        Field(discriminator="kind"),
    ]
)


def parsed(document: object) -> TerminalFault | Cut:
    """The fault that a mapping describes. Raises UsageError with the first thing that is wrong with it."""
    return validated(_ANY, document)
