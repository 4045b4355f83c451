"""What every driver that serves a wire in the loop remembers from cycle to cycle, where loop and host share it."""

from __future__ import annotations

from .counting import COUNTED
from .frames import DEVICE_CLOCK, FRAME, SOCKET
from .link_gate import LINK_GATE
from .samples import SAMPLES

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
