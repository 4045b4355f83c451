"""A link opened, and where the outputs of its device begin: what it has, not what it was given last.

The one place that says what a device may have after silence (``docs/decisions/0017-bus-workers.md``).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from micromanip.rt.io.gate import EQUAL_V, VOLTAGE

from .driver import BusDriver
from .errors import OutputsUnknown, StillOpening
from .inbox import Inbox
from .safe_state import Beginning, Bounds, Known, Left, OutputWriter, SafeState
from .watchdog import Watchdog

_PAUSE_S = 0.02
_SLICE_NS = 20_000_000


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


def begin(
    driver: BusDriver, safe: SafeState, writer: OutputWriter, alive: Callable[[], None], read: Callable[[], Known]
) -> Known:
    """Tell `safe` what the device has, and return what it reads back, by `read`; writes nothing.

    A device that its watchdog leads to rest is waited for, `alive` is called meanwhile. Raises OutputsUnknown where
    nobody can say what a voltage is, and what the driver raises.
    """
    watchdog, values = driver.silence, read()
    unknown = place(safe, watchdog, time.monotonic_ns(), values)
    if unknown and watchdog is not None and watchdog.ms is not None:
        _listen(driver, writer.touched_ns + watchdog.still_ns, alive)
        values = read()
        unknown = place(safe, watchdog, time.monotonic_ns(), values)
        writer.found_still()
    if unknown:
        names = ", ".join(driver.outputs[i].name for i in unknown)
        raise OutputsUnknown(
            f"nobody knows what {names} of {driver.device} has: nothing is written. Say in `watchdog` (ms, rest_ms, "
            "after_power_on) what the device does after silence; or see to it that it is at its safe values, and say "
            "so: `micromanip park --at-rest`"
        )
    return values


def place(safe: SafeState, watchdog: Watchdog | None, now_ns: int, values: Known) -> list[int]:
    """Have the outputs begin where they are, which read back `values`; or of which voltages nobody knows that yet."""
    found: dict[int, Beginning | None] = {}
    for i, value in enumerate(values):
        left = safe.left(i)
        if left.kind == VOLTAGE:
            found[i] = after_silence(watchdog, safe.silent_ns(i, now_ns), left, value)
        elif value is not None:
            found[i] = Beginning(value, (value, value))
    known = {i: beginning for i, beginning in found.items() if beginning is not None}
    for i, beginning in known.items() if len(known) == len(found) else ():
        safe.begin(i, beginning)
    return [i for i in found if i not in known]


def after_silence(watchdog: Watchdog | None, silent_ns: Bounds, left: Left, reads: float | None) -> Beginning | None:
    """Where a voltage is that `reads` that (None: it can't be read); None where nobody knows, or not yet.

    `silent_ns` is how long the device had no command, at least and at most. What can be read may be a set-point, which
    outlasts the voltage: it counts as long as no watchdog can have begun. After that, one away from rest tells nothing
    if it was written from here; if not, somebody else has written it, or what was sent last was lost.
    """
    begins_ns, still_ns = (-math.inf, -math.inf) if watchdog is None else (watchdog.begins_ns, watchdog.still_ns)
    leads, keeps = (False, False) if watchdog is None else (watchdog.leads_to_rest, watchdog.keeps)
    found = None if reads is None else Beginning(reads, (reads, reads))
    reads_rest = found is None or _is_near(found.bounds, left.rest, left.step)
    if found is not None and silent_ns[1] <= begins_ns:
        return found
    if silent_ns[0] < still_ns and not (reads_rest and _is_near(left.given, left.rest, left.step)):
        return None  # it may be on its way to rest
    if found is not None:
        low, high = left.register
        if leads and low > high:  # with nothing written it moves as the voltage does
            return found
        if reads_rest:
            return Beginning(left.rest, _hull(found.bounds, left.rest))
        if not low - left.step <= found.value <= high + left.step:
            return None
    if leads and silent_ns[0] >= still_ns:
        return Beginning(left.rest, (left.rest, left.rest))
    if left.given is None:
        return None
    if keeps:
        return Beginning(left.last, left.given)
    at = left.rest if leads else left.safe  # one left at rest is there: a person's word is asked for once
    return Beginning(at, _hull(left.given, at)) if _is_near(left.given, at, left.step) else None


def _listen(driver: BusDriver, until_ns: int, alive: Callable[[], None]) -> None:
    """Take what comes, and let go of it: a device that is listened to does not fill its line meanwhile."""
    inbox = Inbox()
    while (now_ns := time.monotonic_ns()) < until_ns:
        driver.receive(inbox, min(until_ns, now_ns + _SLICE_NS))
        inbox.clear()
        alive()


def _is_near(bounds: Bounds | None, value: float, step: float) -> bool:
    return bounds is not None and max(abs(bounds[0] - value), abs(bounds[1] - value)) <= step + EQUAL_V


def _hull(bounds: Bounds, value: float) -> Bounds:
    return min(bounds[0], value), max(bounds[1], value)
