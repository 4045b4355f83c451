"""The loop's side of the cyclic drivers: one call each, by address."""

from __future__ import annotations

from typing import Any

from .intrinsics import call_exchange
from .jit import compiled
from .records import SIGNAL

_SIGNAL_BYTES = SIGNAL.itemsize
_OUTPUT_BYTES = 8


@compiled
def exchange_all(drivers: Any, count: int, outputs: Any, signals: Any, now_ns: int, periods: int) -> int:
    """Write `outputs`, read `signals` through every driver.

    0; else the code of the first that failed; else, where a link is down, -1 less the number of that driver.
    """
    failed = 0
    for i in range(count):
        code = call_exchange(
            drivers[i]["exchange"],
            drivers[i]["context"],
            outputs.ctypes.data + drivers[i]["first_output"] * _OUTPUT_BYTES,
            signals.ctypes.data + drivers[i]["first_input"] * _SIGNAL_BYTES,
            now_ns,
            periods,
        )
        if code > 0 and failed <= 0:
            failed = code
        elif code < 0 and failed == 0:
            failed = -1 - i
    return failed
