"""The wires that the loop itself serves: links in the report, beside those of the bus workers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping

from micromanip.bus.cyclic import CyclicDriver, Wire
from micromanip.errors import DeviceUnavailable
from micromanip.replies import Link
from micromanip.rt.bus_image import FOLLOWING, LINK_DOWN, LINK_NAMES, LINK_UP, OUTPUT_NAMES

_LOCKS_IN_S, _POLL_S = 60.0, 0.01


async def on_the_clock(name: str, link: Callable[[], Link], ends: Callable[[], bool]) -> bool:
    """Wait until the loop follows the clock of the driver called `name`; False where it `ends` before.

    Raises DeviceUnavailable where that takes too long: nobody is told READY while the deadlines still move.
    """
    begin = time.monotonic()
    while not ends():
        found = link()
        if found["outputs"] == OUTPUT_NAMES[FOLLOWING]:
            return True
        if time.monotonic() - begin > _LOCKS_IN_S:
            counts = ", ".join(f"{key} {value}" for key, value in found["counts"].items() if value)
            raise DeviceUnavailable(
                f"driver {name}: its outputs do not follow the loop, whose deadlines are to lock to its clock: {counts}"
            )
        await asyncio.sleep(_POLL_S)
    return False


def wire_link(driver: CyclicDriver, wire: Wire, counts: Mapping[str, int], places: Mapping[str, int]) -> Link:
    """What people are told of it; `places` has each output's and switch's place among those of `driver`."""
    given = wire.given if wire.sent_ns else (None,) * len(driver.outputs)
    return {
        "link": LINK_NAMES[LINK_UP if wire.up else LINK_DOWN],
        "outputs": wire.outputs,
        "given": {name: given[place] for name, place in places.items()},
        "given_s_ago": round(time.monotonic() - wire.sent_ns * 1e-9, 3) if wire.sent_ns else None,
        "links": wire.links,
        "starts": 0,
        "message": None,
        "counts": dict(counts),
        "cpu_s": 0.0,
    }
