"""State of every driver that serves a wire in the loop, in memory that loop and host share."""

from __future__ import annotations

from micromanip.rt.record import record

from .clock_lock import DEVICE_CLOCK
from .counting import COUNTED
from .frames import FRAME, MAX_BYTES, SAMPLES
from .link_gate import LINK_GATE

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
"""A datagram socket of this process (``sockets.py``): what came is in `received`, what goes out in `sent`."""

WIRE = (
    ("opened", "i8"),
    ("closed", "i8"),
    ("counts", "i8"),
    ("gate", LINK_GATE),
    ("samples", SAMPLES),
    ("counted", COUNTED),
    ("clock", DEVICE_CLOCK),
    ("receive", FRAME),
    ("send", FRAME),
    ("socket", SOCKET),
    ("wait_ns", "i8"),
    ("answered", "i8"),
    ("news", "i8"),
    ("received", "i8"),
    ("wrong_length", "i8"),
    ("not_sent", "i8"),
)
"""Fields of its context. The count of what is sent begins anew after `counts`. The loop waits until `wait_ns`
after the deadline for its answer: of all that was sent so many are `answered`, the last with those before. `news`
acknowledgements came so, which count in the next cycle. `received` frames came, some of a `wrong_length`, and
`not_sent` is what the system did not take."""
