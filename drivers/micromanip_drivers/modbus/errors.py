"""What is wrong with an answer, and what a device means by an exception code."""

# ruff: noqa: N818 (the names say what came)

from __future__ import annotations

from micromanip.driver import BusError, DeviceFault, TransientError

_MEANINGS = {
    1: "illegal function: it has none with this code",
    2: "illegal address: not all of these registers are there; compare address and address_base with its manual",
    3: "illegal value: it does not take the value, or so many registers at once",
    4: "device failure: look at the device itself",
    5: "acknowledged: it will take longer than a transaction",
    6: "busy",
    7: "negative acknowledge: it can't do that",
    8: "memory parity error: its memory is damaged",
    10: "gateway path unavailable: the gateway is overloaded, or not set up for this unit",
    11: "gateway target: the unit behind the gateway does not answer",
}
_PASSING = (5, 6, 11)
"""Those that another try may not meet."""


class BadFrame(Exception):
    """What came is no answer to what was asked, and more of it may be under way."""


class DamagedFrame(BadFrame):
    """It has the form and length of the answer, and a wrong checksum: nothing more is to be expected."""


def exception_error(title: str, code: int) -> BusError:
    """The error that stands for a Modbus exception, which answered the transaction called `title`."""
    text = f"{title}: exception {code}, {_MEANINGS.get(code, 'of the vendor: see its manual')}"
    return TransientError(text) if code in _PASSING else DeviceFault(text)
