"""All driver workers of a controller; and the wires that the loop itself serves: links, beside those of the workers."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterator, Mapping
from types import TracebackType
from typing import Self

from micromanip.bus.cyclic import CyclicDriver, Wire
from micromanip.errors import CheckFailed, DeviceUnavailable
from micromanip.rt.bus_image import FOLLOWING, LINK_DOWN, LINK_NAMES, LINK_UP, OUTPUT_NAMES
from micromanip.settings.check import Prepared
from micromanip.status_reply import Link

from .bus_worker import BusWorker
from .shared_memory import Segments

_IN_HAND_S, _POLL_S = 5.0, 0.01
"""A device that begins away from rest is brought there before READY, which waits so much longer than the way takes."""
_ANSWERS_IN_S, _LOCKS_IN_S = 15.0, 60.0


class Workers:
    """One process for each bus of a configuration."""

    def __init__(
        self,
        prepared: Prepared,
        segments: Segments,
        offsets: list[int],
        locks: tuple[int, ...],
        say: Callable[[str], None],
        ends: Callable[[], bool] = lambda: False,
    ) -> None:
        """`offsets` (bytes) tell where each driver's context is; no link is waited for once it `ends`."""
        wiring = prepared.wiring
        self._workers = [
            BusWorker(prepared, name, segments, offset, locks)
            for name, offset in zip(wiring.drivers, offsets, strict=True)
            if name in wiring.buses
        ]
        self._say, self._ends = say, ends
        self._supervising: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Self:
        """Start all and wait until every link is up; DeviceUnavailable where one does not come up.

        KeyboardInterrupt where it ends before that.
        """
        try:
            for worker in self._workers:
                await worker.start(self._say)
            for worker in self._workers:
                await worker.first_link(self._ends)
        except BaseException as problem:
            await self.__aexit__(type(problem), problem, None)
            raise
        self._supervising = [asyncio.create_task(worker.supervise(self._say)) for worker in self._workers]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all, with their outputs at rest; raises CheckFailed where a device may have kept a voltage."""
        await asyncio.gather(*(worker.end() for worker in self._workers))
        for task in self._supervising:
            task.cancel()
        left = [f"driver {worker.name}: {worker.outputs_text}" for worker in self._workers if not worker.rests]
        if left and value is None:
            raise CheckFailed(f"{'; '.join(left)}. See what its device puts out; then `micromanip park`")
        for text in left:
            self._say(f"WARNING: {text}")

    async def in_hand(self, ends: Callable[[], bool]) -> bool:
        """Wait until all outputs are at rest and follow the loop; False where it `ends` before.

        Raises DeviceUnavailable where that takes too long: nobody is told READY while a device may have a voltage.
        """

        def away() -> Iterator[tuple[str, float, str]]:
            for worker in self._workers:
                if not worker.is_in_hand:
                    what = f"its outputs are not brought to rest: {worker.outputs_text}"
                    yield worker.name, worker.way_to_rest_s + _IN_HAND_S, "; ".join(filter(None, (what, worker.said)))

        return await _nothing_is_away(away, ends)

    def adopt(self, prepared: Prepared) -> None:
        """Go by the limits and times of another configuration from now on."""
        for worker in self._workers:
            worker.adopt(prepared)

    def report(self) -> dict[str, Link]:
        """Where each link stands, by the driver's name."""
        return {worker.name: worker.report() for worker in self._workers}

    def outputs_text(self) -> dict[str, str]:
        """What people are told of the outputs of each driver with the loop dead."""
        return {worker.name: worker.outputs_text for worker in self._workers}


async def follow(links: Callable[[], Mapping[str, Link]], steering: str | None, ends: Callable[[], bool]) -> bool:
    """Wait until the device on every wire answers, with its outputs in the loop's hand; False where it `ends` before.

    `steering` is the driver whose clock the loop's deadlines follow, if any: its outputs follow once that is locked.
    Raises DeviceUnavailable where it takes too long: nobody is told READY while a device is missing, or the deadlines
    still move.
    """

    def away() -> Iterator[tuple[str, float, str]]:
        for name, link in links().items():
            if link["outputs"] != OUTPUT_NAMES[FOLLOWING]:
                yield name, _LOCKS_IN_S if name == steering else _ANSWERS_IN_S, _missing(link, name == steering)

    return await _nothing_is_away(away, ends)


async def _nothing_is_away(away: Callable[[], Iterator[tuple[str, float, str]]], ends: Callable[[], bool]) -> bool:
    """Wait until no driver is; of each that is, its name, how long it is waited for, and what is to be said then."""
    begin = time.monotonic()
    while not ends():
        found = list(away())
        if not found:
            return True
        for name, patience_s, why in found:
            if time.monotonic() - begin > patience_s:
                raise DeviceUnavailable(f"driver {name}: {why}")
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
