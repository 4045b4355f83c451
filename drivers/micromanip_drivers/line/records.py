"""The messages of ``binary`` as tables, and the bytes on their way: what compiled functions (``exchange.py``) go by."""

from __future__ import annotations

from micromanip.driver.wire import COUNTED, FRAME, MAX_BYTES, NUMBER, SAMPLES, record

MAX_MESSAGES = 16
"""Of each direction."""
MAX_SYNC_BYTES, MAX_CHUNKS = 16, 32
READ_BYTES = 4096
"""What one reading takes at most."""
_BUFFER_BYTES = MAX_BYTES + READ_BYTES

RECEIVED = record(
    ("frame", FRAME),
    ("kind", "u8"),
    ("input", "i8"),
    ("counter", COUNTED),
    ("counted", "i8"),
    ("samples", "i8"),
    ("by_sample", "i8"),
)
"""A message that is received; its inputs from `input` on. It has so many `samples` of each, the frame shows the
last. It is counted by the counter of the message `counted`: by 1 a frame, or by its samples where `by_sample` is 1."""

SENT = record(("frame", FRAME), ("output", "i8"), ("count", "i8"), ("unheard", "i8"))
"""A message that is sent; its outputs from `output` on, the count of its next frame. `unheard` is 1 after it was sent,
until something is heard of the device."""

CONTEXT = record(
    ("received_messages", "i8"),
    ("received", RECEIVED, (MAX_MESSAGES,)),
    ("sent_messages", "i8"),
    ("sent", SENT, (MAX_MESSAGES,)),
    ("sync", "u1", (MAX_SYNC_BYTES,)),
    ("sync_bytes", "i8"),
    ("header_bytes", "i8"),
    ("longest", "i8"),
    ("kind", NUMBER),
    ("length", NUMBER),
    ("plus", "i8"),
    ("descriptor", "i8"),
    ("waiting_request", "i8"),
    ("silence_ns", "i8"),
    ("heard_ns", "i8"),
    ("buffer", "u1", (_BUFFER_BYTES,)),
    ("filled", "i8"),
    ("chunk_end", "i8", (MAX_CHUNKS,)),
    ("chunk_ns", "i8", (MAX_CHUNKS,)),
    ("chunks", "i8"),
    ("frame", "u1", (MAX_BYTES,)),
    ("unsent", "i8"),
    ("frame_bytes", "i8"),
    ("left", "i8"),
    ("receive_error", "i8"),
    ("send_error", "i8"),
    ("bytes_in", "i8"),
    ("bytes_out", "i8"),
    ("frames", "i8"),
    ("more_lost", "i8"),
    ("samples", SAMPLES),
    ("waiting", "i4", (1,)),
    ("timespec", "i8", (2,)),
)
"""The driver as compiled code sees it.

`header_bytes` of a frame say which one it is and how long: by `kind` and `length`, where they are present. What came
and is no whole frame yet is in `buffer`, chunk by chunk: up to where each of them reaches, and when it came. `left` is
1 where that is for Python to judge. `frame` is the one that is looked at, or sent; then it has `frame_bytes`, of which
the system has not taken the last `unsent` yet. `waiting_request` asks the system how much it has not sent yet.
`silence_ns` is 0 where silence is no error.
"""
