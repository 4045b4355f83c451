"""The wires that the loop itself serves: links in the report, beside those of the bus workers."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Mapping

from micromanip.bus.cyclic import CyclicDriver, Wire
from micromanip.errors import DeviceUnavailable
from micromanip.rt.bus_image import FOLLOWING, LINK_DOWN, LINK_NAMES, LINK_UP, OUTPUT_NAMES
from micromanip.status_reply import Link

_ANSWERS_IN_S, _LOCKS_IN_S, _POLL_S = 15.0, 60.0, 0.01


async def follow(links: Callable[[], Mapping[str, Link]], steering: str | None, ends: Callable[[], bool]) -> bool:
    """Wait until the device on every wire answers, with its outputs in the loop's hand; False where it `ends` before.

    `steering` is the driver whose clock the loop's deadlines follow, if any: its outputs follow once that is locked.
    Raises DeviceUnavailable where it takes too long: nobody is told READY while a device is missing, or the deadlines
    still move.
    """
    begin = time.monotonic()
    while not ends():
        away = {name: link for name, link in links().items() if link["outputs"] != OUTPUT_NAMES[FOLLOWING]}
        if not away:
            return True
        for name, link in away.items():
            if time.monotonic() - begin > (_LOCKS_IN_S if name == steering else _ANSWERS_IN_S):
                raise DeviceUnavailable(f"driver {name}: {_missing(link, name == steering)}")
        await asyncio.sleep(_POLL_S)
    return False


def _missing(link: Link, steers: bool) -> str:
    counts = ", ".join(f"{key} {value}" for key, value in link["counts"].items() if value) or "nothing came at all"
    if link["link"] != LINK_NAMES[LINK_UP]:
        answers = 2 * link["counts"].get("received", 0) > link["counts"].get("unanswered", math.inf)
        does = "answers, and does not act on what it is sent" if answers else "does not answer"
        return f"its device {does}: {counts}"
    why = ", whose deadlines are to lock to its clock" if steers else ""
    return f"its outputs do not follow the loop{why}: {counts}"


def loop_link(driver: CyclicDriver, wire: Wire, counts: Mapping[str, int], places: Mapping[str, int]) -> Link:
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
