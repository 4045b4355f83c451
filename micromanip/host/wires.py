"""The wires that the loop itself serves: links in the report, beside those of the bus workers."""

from __future__ import annotations

import time
from collections.abc import Mapping

from micromanip.bus.cyclic import CyclicDriver, Wire
from micromanip.replies import Link
from micromanip.rt.bus_image import LINK_DOWN, LINK_NAMES, LINK_UP


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
