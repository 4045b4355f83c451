"""A call that is made again and again, until something comes of it."""

import time

from micromanip.bus.errors import BusError


def raised(call, passing=(), seconds=3.0):
    """The first bus error, but those that are `passing`, of calling it again and again; None if there was none."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        try:
            call()
        except passing:
            time.sleep(0.001)
        except BusError as problem:
            return problem
    return None
