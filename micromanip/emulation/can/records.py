"""What compiled code knows of test buses and their CAN devices, and how much there may be of it."""

from __future__ import annotations

from micromanip.rt.record import record
from micromanip.rt.wire.records import SOCKET

from ..compiled_plant import PLANT
from .frames import FIELD, PACKET_BYTES

MAX_BUSES, MAX_CLIENTS, MAX_MESSAGES, MAX_FIELDS = 4, 4, 16, 192
NOBODY = -1
"""Sends on a bus that is idle; a client is 0 and up, a message of the devices MAX_CLIENTS and up."""
ODD = -1
"""What ``serve`` and ``catch_up`` return where Python has to go on."""
KINDS, LENGTHS = 3, 65
"""Classic frames, CAN FD without a second bit rate, and with it; lengths of their data."""
FAR_NS = 1 << 62
"""A time that does not come."""

CLIENT = record(("waiting", "i8"), ("next", "i8"), ("heard_ns", "i8"), ("dropped", "i8"), ("socket", SOCKET))
"""A participant in another process: `waiting` packets of a batch, which had come at `heard_ns`, from `next` on."""

MESSAGE = record(
    ("period_ns", "i8"),
    ("due_ns", "i8"),
    ("count", "i8"),
    ("counter", FIELD),
    ("field", "i8"),
    ("fields", "i8"),
    ("packet", "u1", (PACKET_BYTES,)),
    ("empty", "u1", (PACKET_BYTES,)),
    ("bytes", "i8"),
    ("priority", "i8"),
    ("duration_ns", "i8"),
    ("waits", "i8"),
    ("arrival_ns", "i8"),
    ("sent", "i8"),
)
"""One that the devices send: a node of its own. `packet` is filled, and `waits` for the bus or is on it, from the
time on when it was due; `empty` is it with zeros for data."""

COMMAND = record(("word", "i8"), ("length", "i8"), ("field", "i8"), ("fields", "i8"))
"""One that they take, by the identifier's word."""

BUS = record(
    ("clients", "i8"),
    ("client", CLIENT, (MAX_CLIENTS,)),
    ("messages", "i8"),
    ("message", MESSAGE, (MAX_MESSAGES,)),
    ("commands", "i8"),
    ("command", COMMAND, (MAX_MESSAGES,)),
    ("field", FIELD, (MAX_FIELDS,)),
    ("fd", "i8"),
    ("duration_ns", "i8", (2, KINDS, LENGTHS)),
    ("sender", "i8"),
    ("end_ns", "i8"),
    ("free_ns", "i8"),
    ("frames", "i8"),
    ("busy_ns", "i8"),
    ("received", "i8"),
    ("not_understood", "i8"),
    ("refused", "i8"),
    ("heard_ns", "i8"),
    ("value", "f8", (MAX_FIELDS,)),
    ("scratch", "u8", (1,)),
)
"""A bus with what is on it, by `duration_ns` for standard and extended identifiers; what happened since Python has
last looked."""

SERVED = record(
    *PLANT, ("buses", "i8"), ("late_ns", "i8"), ("rested_ns", "i8"), ("descriptors", "i8"), ("timespec", "i8", (2,))
)
"""The plant, and how late the latest frame was given to its clients. The first so many `descriptors` are Python's."""
