"""Where the outputs of a device begin whose link has just been opened: what it has, not what it was given last."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from .driver import BusDriver
from .errors import OutputsUnknown
from .inbox import Inbox
from .output_writer import OutputWriter
from .safe_state import SafeState

_SLICE_NS = 20_000_000


def begin(
    driver: BusDriver,
    safe: SafeState,
    writer: OutputWriter,
    alive: Callable[[], None],
    read: Callable[[], Sequence[float | None]],
) -> Sequence[float | None]:
    """Tell `safe` what the device has, and return what it reads back, by `read`; writes nothing.

    A device that its watchdog leads to rest is waited for, `alive` is called meanwhile. Raises OutputsUnknown where a
    voltage can't be read back and nobody can say what it is, and what the driver raises.
    """
    watchdog, values = driver.silence, read()
    if watchdog is not None and watchdog.ms is not None:
        goes_on = safe.all_told(values) and not writer.is_in_doubt()
        if not goes_on and not safe.is_near_rest(values):
            _listen(driver, writer.touched_ns + watchdog.still_ns, alive)
            values = read()
            writer.found_still()
    unknown = safe.after_silence(watchdog, time.monotonic_ns() - writer.touched_ns, values)
    if unknown:
        names = ", ".join(driver.outputs[i].name for i in unknown)
        raise OutputsUnknown(
            f"nobody knows what {names} of {driver.device} has: nothing is written. Say in `watchdog` (ms, rest_ms, "
            "after_power_on) what the device does after silence; or see to it that it is at its safe values, and say "
            "so: `micromanip park --at-rest`"
        )
    return values


def _listen(driver: BusDriver, until_ns: int, alive: Callable[[], None]) -> None:
    """Take what comes, and let go of it: a device that is listened to does not fill its line meanwhile."""
    inbox = Inbox()
    while (now_ns := time.monotonic_ns()) < until_ns:
        driver.receive(inbox, min(until_ns, now_ns + _SLICE_NS))
        inbox.clear()
        alive()
