"""A frame as a table: where its numbers lie and how their bytes become values; ``codec.py`` walks it.

A frame has a fixed length. `template` is the frame before anything is written into it; where `fixed` is 1, a frame
that comes must have the template's byte. Groups are numbers that were sampled together: group 0 with every frame,
another one when its own counter has changed (a laser tracker's reading, say, that a faster frame carries along).
"""

from __future__ import annotations

from micromanip.rt.record import record
from micromanip.rt.records import MAX_SIGNALS

UNSIGNED, SIGNED, FLOATING = range(3)
MAX_BYTES = 1472
"""What one datagram carries over Ethernet without being cut."""
MAX_GROUPS, MAX_GOOD = 8, 8

CODE = (("kind", "i8"), ("scale", "f8"), ("offset", "f8"), ("lowest_code", "f8"), ("highest_code", "f8"))
"""Fields of a number of any layout (``numbers.py``): value = scale x code + offset; a code outside of its two is not
sent."""

NUMBER = record(
    ("present", "i8"),
    ("at", "i8"),
    ("size", "i8"),
    ("big", "i8"),
    ("bit", "i8"),
    ("bits", "i8"),
    *CODE,
    ("low", "f8"),
    ("high", "f8"),
)
"""A number of `size` whole bytes, or where that is 0 of `bits` from bit number `bit` of its first byte on, the lowest
first; a value outside of `low` to `high` is not sent."""

CHECKSUM = record(
    ("size", "i8"),
    ("first", "i8"),
    ("big", "i8"),
    ("reflected", "i8"),
    ("constant", "u8"),
    ("table", "u8", (256,)),
)
"""A CRC: a register that begins with 0 and takes in the bytes from `first` on, xor a constant.

Initial value and final xor of a CRC add a constant to it that depends on the number of bytes alone, which is fixed.
"""

GROUP = record(("counter", NUMBER), ("latency_ns", "i8"))
"""Numbers that were sampled together, `latency_ns` before the frame was finished; without a counter with each frame."""

FRAME = record(
    ("length", "i8"),
    ("template", "u1", (MAX_BYTES,)),
    ("fixed", "u1", (MAX_BYTES,)),
    ("checksum", CHECKSUM),
    ("counter", NUMBER),
    ("acknowledged", NUMBER),
    ("clock", NUMBER),
    ("status", NUMBER),
    ("mask", "u8"),
    ("good", "u8", (MAX_GOOD,)),
    ("goods", "i8"),
    ("groups", "i8"),
    ("group", GROUP, (MAX_GROUPS,)),
    ("numbers", "i8"),
    ("number", NUMBER, (MAX_SIGNALS,)),
    ("group_of", "i8", (MAX_SIGNALS,)),
    ("bits", "u8", (1,)),
)
"""One kind of frame; `acknowledged` is the count of the frame that its sender has taken last, `clock` the device's time
stamp, `bits` scratch for the bits of a number."""

SO_TIMESTAMPNS = 35
"""Option of a socket, and kind of the message in which the kernel then says when a datagram came."""
BATCH = 8
"""Datagrams that one system call takes at most."""
ADDRESS_BYTES = 28
"""A ``sockaddr_in6``, the longest there is."""

MESSAGE = record(
    ("name", "i8"),
    ("name_bytes", "u4"),
    ("buffers", "i8"),
    ("buffer_count", "i8"),
    ("control", "i8"),
    ("control_bytes", "i8"),
    ("flags", "i4"),
    ("unused", "u4"),
    ("length", "u4"),
)
"""``struct mmsghdr`` of 64-bit Linux; what begins with an address is one of the process that has the socket."""
BUFFER = record(("base", "i8"), ("length", "i8"))
"""``struct iovec``"""
CONTROL = record(("length", "i8"), ("level", "i4"), ("kind", "i4"), ("seconds", "i8"), ("nanoseconds", "i8"))
"""``struct cmsghdr`` with the one message that is asked for: the kernel's time of reception, of the wall clock."""

SOCKET = record(
    ("descriptor", "i8"),
    ("peer", "u1", (ADDRESS_BYTES,)),
    ("peer_mask", "u1", (ADDRESS_BYTES,)),
    ("message", MESSAGE, (BATCH,)),
    ("buffer", BUFFER, (BATCH,)),
    ("name", "u1", (BATCH, ADDRESS_BYTES)),
    ("control", CONTROL, (BATCH,)),
    ("received", "u1", (BATCH, MAX_BYTES)),
    ("sent", "u1", (MAX_BYTES,)),
    ("now_ns", "i8"),
    ("earliest_ns", "i8"),
    ("wall_ns", "i8"),
    ("timespec", "i8", (2,)),
)
"""A datagram socket of this process (``datagrams.py``): what came is in `received`, what goes out in `sent`."""

DEVICE_CLOCK = record(
    ("unit_ns", "f8"),
    ("bits", "i8"),
    ("known", "i8"),
    ("stamp", "i8"),
    ("ticks", "i8"),
    ("apart_ns", "i8"),
    ("received_ns", "i8"),
    ("late", "i8"),
    ("steps", "i8"),
)
"""Of a time stamp of so many `bits`, in units of `unit_ns`, and what is known so far (``device_clock.py``)."""
