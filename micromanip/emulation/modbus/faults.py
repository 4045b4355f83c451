"""Faults of Modbus devices, beside those of every line (``emulation/line/faults.py``):

    exception    requests are answered with exception ``code``: {"inject": "exception", "code": 6, "share": 0.1}
    transaction  answers carry the number of another request; Modbus TCP only

Others that matter here: ``delay`` for a late answer, ``hang`` for a gateway that hangs and for a TCP connection that is
half open, ``disconnect`` after it for the moment in which that shows, ``echo`` for an RS-485 adapter.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from micromanip.emulation.line import faults as line_faults
from micromanip.emulation.line.faults import LineFault, MessageFault, Parts
from micromanip.errors import UsageError
from micromanip.testbus.fault import validated

_NUMBER_BYTES = 2


class ModbusException(MessageFault):
    """Requests are refused; nothing is done."""

    kind: Literal["exception"]
    code: Annotated[int, Field(ge=1, le=255)] = 4


class WrongTransaction(MessageFault):
    """Answers carry the number of the request after the one that they answer."""

    kind: Literal["transaction"]

    def through(self, message: bytes) -> Parts:
        number = int.from_bytes(message[:_NUMBER_BYTES], "big") + 1
        return [(0, (number % 0x10000).to_bytes(_NUMBER_BYTES, "big") + message[_NUMBER_BYTES:])]


_OWN: TypeAdapter[MessageFault] = TypeAdapter(
    Annotated[ModbusException | WrongTransaction, Field(discriminator="kind")]
)


def parsed(document: Mapping[str, Any], *, serial: bool) -> LineFault:
    """The fault that a mapping describes. Raises UsageError with the first thing that is wrong with it."""
    kind = document.get("kind")
    if kind not in ("exception", "transaction"):
        return line_faults.parsed(document)
    if kind == "transaction" and serial:
        raise UsageError("fault transaction: on a serial line answers have no number")
    return validated(_OWN, document)
