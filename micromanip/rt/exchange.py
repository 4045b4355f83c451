"""The loop's side of the cyclic drivers: one call each, by address."""

from __future__ import annotations

from typing import Any

from .bus_image import AWAY, TAKEN
from .intrinsics import call_exchange
from .jit import compiled
from .records import MAX_DRIVERS, SIGNAL

_SIGNAL_BYTES = SIGNAL.itemsize
_OUTPUT_BYTES = 8
FIRST_TAKEN = -1 - MAX_DRIVERS
"""What ``exchange_all`` returns where the first driver's outputs do not follow the loop; one less for the second."""
ALL_FOLLOW = FIRST_TAKEN - MAX_DRIVERS
"""What it returns where all outputs follow the loop, and those of a bus are not known to be at rest."""


@compiled
def exchange_all(drivers: Any, count: int, outputs: Any, signals: Any, now_ns: int, periods: int) -> int:
    """Write `outputs`, read `signals` through every driver.

    0; else the code of the first that failed; else, where a link is down, -1 less the number of that driver; else,
    where outputs do not follow the loop, `FIRST_TAKEN` less the number of that driver; else, where a device is not
    known to be at rest, `ALL_FOLLOW`.
    """
    failed, down, taken, away = 0, 0, 0, 0
    for i in range(count):
        code = call_exchange(
            drivers[i]["exchange"],
            drivers[i]["context"],
            outputs.ctypes.data + drivers[i]["first_output"] * _OUTPUT_BYTES,
            signals.ctypes.data + drivers[i]["first_input"] * _SIGNAL_BYTES,
            now_ns,
            periods,
        )
        if code > 0 and failed == 0:
            failed = code
        elif code == TAKEN and taken == 0:
            taken = FIRST_TAKEN - i
        elif code == AWAY:
            away = ALL_FOLLOW
        elif code < 0 and code != TAKEN and down == 0:
            down = -1 - i
    if failed != 0:
        return failed
    if down != 0:
        return down
    return taken if taken != 0 else away
