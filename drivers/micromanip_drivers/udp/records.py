"""What the driver remembers from cycle to cycle, in memory that loop and host share."""

from __future__ import annotations

from micromanip.driver import Compiler
from micromanip.driver.wire import WIRE, record

compiled = Compiler(__file__)

BAD = ("wrong_length", "wrong_checksum", "not_this_datagram", "not_sent")
"""Three kinds of bad datagrams; those that the system did not take."""

CONTEXT = record(*WIRE, ("strangers", "i8"), ("wrong_checksum", "i8"), ("not_this_datagram", "i8"))
"""``strangers`` are datagrams of others."""
