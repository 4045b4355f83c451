"""Opening a driver that takes its time, with everything else looked after meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable

from .driver import BusDriver
from .errors import StillOpening

_PAUSE_S = 0.02


def opened(driver: BusDriver, goes_on: Callable[[StillOpening, float], bool]) -> bool:
    """Open `driver`, however often it takes; False where ``goes_on(problem, seconds since the beginning)`` ends it.

    Raises what ``open`` does.
    """
    began = time.monotonic()
    while True:
        try:
            driver.open()
        except StillOpening as problem:
            if not goes_on(problem, time.monotonic() - began):
                return False
            time.sleep(_PAUSE_S)
        else:
            return True
