"""The messages of a configuration as tables, and the socket: what the compiled functions (``exchange.py``) go by."""

from __future__ import annotations

from micromanip.driver import Compiler
from micromanip.driver.wire import BATCH, CODE, COUNTED, SOCKET, record

compiled = Compiler(__file__)

MAX_MESSAGES, MAX_FIELDS, MAX_GOOD = 32, 192, 8
"""Of each direction; of both together; values of a status that mean good."""
MAX_WATCHED = 64
MAX_PACKET_BYTES = 72

FIELD = record(("big", "i8"), ("byte", "i8"), ("bit", "i8"), ("bits", "i8"), *CODE)
"""A signal: its lowest bit is number `bit` of byte `byte`, counted from the end of the frame where it is `big`."""

RECEIVED = record(
    ("word", "i8"),
    ("length", "i8"),
    ("latency_ns", "i8"),
    ("input", "i8"),
    ("field", "i8"),
    ("fields", "i8"),
    ("counted", "i8"),
    ("counter_field", FIELD),
    ("counter", COUNTED),
    ("judged", "i8"),
    ("status_field", FIELD),
    ("goods", "i8"),
    ("good", "u8", (MAX_GOOD,)),
)
"""A message that is received: identifier with its flag, its inputs from `input` and their fields from `field` on."""

SENT = record(
    ("word", "i8"),
    ("bytes", "i8"),
    ("packet", "u1", (MAX_PACKET_BYTES,)),
    ("length", "i8"),
    ("output", "i8"),
    ("field", "i8"),
    ("fields", "i8"),
    ("counted", "i8"),
    ("counter_field", FIELD),
    ("counts", "i8"),
    ("count", "i8"),
)
"""A message that is sent: `packet` is it before anything is written into its data, a ``struct canfd_frame``."""

FRAMES = (
    ("received_messages", "i8"),
    ("received", RECEIVED, (MAX_MESSAGES,)),
    ("sent_messages", "i8"),
    ("sent", SENT, (MAX_MESSAGES,)),
    ("field", FIELD, (MAX_FIELDS,)),
    ("watched", "i8", (MAX_WATCHED,)),
    ("watched_words", "i8"),
    ("fd", "i8"),
    ("stamp_bytes", "i8"),
    ("heard_ns", "i8"),
    ("left", "i8"),
    ("odd", "i8", (BATCH,)),
    ("odd_ns", "i8", (BATCH,)),
    ("receive_error", "i8"),
    ("send_error", "i8"),
    ("frames_in", "i8"),
    ("frames_out", "i8"),
    ("not_ours", "i8"),
    ("bits", "u8", (1,)),
    ("socket", SOCKET),
)
"""What every driver of a CAN bus is in compiled code. Frames with an identifier that is `watched`, of `watched_words`,
are Python's. `stamp_bytes` come before each frame on the test bus: its time. `left` frames are marked in `odd` and
wait, with their times, in the socket's record for Python, as do the numbers of the two errors."""

CONTEXT = record(*FRAMES, ("silence_ns", "i8"))
"""`silence_ns` is 0 where silence is no error."""
