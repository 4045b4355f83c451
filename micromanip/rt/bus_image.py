"""The process image of one bus: shared memory between its worker process and the loop.

The worker publishes each input when it has come, the loop takes all of them once per cycle; the loop leaves the outputs
of every cycle, the worker takes the newest when it is about to write. Neither waits for the other. Each side's
payload is guarded by a turn number that is odd while it is being written: a reader that meets an odd or a changed
one tries again, a bounded number of times, and otherwise keeps what it had. The loop's side is compiled
(``bus_exchange.py``), the worker's is Python (``bus/image.py``).

    word           written by   says
    OUTPUT_TURN    loop         turn of the outputs
    WRITTEN_NS     loop         when the loop wrote them: its sign of life
    LINK           worker       where the link stands, see LINK_NAMES
    EPOCH          worker       grows by one each time the link has come up: what was before is over
    ALIVE_NS       worker       its sign of life
    SENT_TURN      worker       turn of the values that the device was given last
    SENT_NS        worker       when it was given those
    OUTPUT_STATE   worker       whether the outputs follow the loop, see OUTPUT_NAMES
    AT_REST        worker       1 where the device has taken the safe value of every voltage, and is given no other next
    EPOCH_SEEN     loop         newest epoch that the loop has met
    ALIVE_SEEN     loop         newest sign of life that it has met; LOOKED_NS: when it looked
    SILENT_NS      loop         for how long it has seen no newer one
"""

from __future__ import annotations

import numpy as np

from .records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL

OUTPUT_TURN, WRITTEN_NS, LINK, EPOCH, ALIVE_NS, SENT_TURN, SENT_NS, OUTPUT_STATE, EPOCH_SEEN, AT_REST = range(10)
ALIVE_SEEN, LOOKED_NS, SILENT_NS = range(10, 13)
_WORDS = 16

LINK_DOWN, LINK_UP, LINK_LATCHED = range(3)
LINK_NAMES = ("down", "up", "latched")
"""Not reached, in use, or not tried again until a person has acted."""

RESTING, FOLLOWING, SAFE_RAMP, UNKNOWN = range(4)
OUTPUT_NAMES = ("at rest", "following", "ramping to rest", "unknown")
"""The device was given the safe values, follows the loop, is on the ramp to the safe values, or can't be reached."""

DOWN, TAKEN, AWAY = -1, -2, -3
"""What the loop's exchange returns while the link can't be used, while the outputs do not follow the loop, and while
they follow it and the device is not known to be at rest."""
TRIES = 4
"""A reader that meets a half-written payload so often keeps what it had."""

IMAGE = np.dtype(
    [
        ("words", "i8", (_WORDS,)),
        ("inputs", "i8"),
        ("outputs", "i8"),
        ("silent_ns", "i8"),
        ("timespec", "i8", (2,)),
        ("value", "f8", (MAX_OUTPUTS,)),
        ("sent", "f8", (MAX_OUTPUTS,)),
        ("turned_ns", "i8", (MAX_OUTPUTS,)),
        ("patience_ns", "i8", (MAX_OUTPUTS,)),
        ("input_turn", "i8", (MAX_SIGNALS,)),
        ("input", SIGNAL, (MAX_SIGNALS,)),
        ("missing", "i8", (MAX_SIGNALS,)),
        ("missing_before", "i8", (MAX_SIGNALS,)),
    ],
    align=True,
)
"""``inputs`` and ``outputs`` are how many there are; a worker silent for longer than ``silent_ns`` is lost. ``value``
is what the loop wants, ``sent`` what the device was given last; NaN where it was not given anything yet. At
``turned_ns`` each output had its turn last, acknowledged or not; one that follows and has had none for longer than
``patience_ns`` has to wait (``laws/saturation.py``). Of each input so many samples are ``missing``, known never to have
come, some of them before the loop saw its first one."""
