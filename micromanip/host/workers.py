"""All driver workers of a controller."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from micromanip.errors import CheckFailed
from micromanip.replies import Link
from micromanip.settings.check import Prepared

from .bus_worker import BusWorker
from .shared_memory import Segments

_IN_HAND_S, _POLL_S = 5.0, 0.01
"""A device that begins away from rest is brought there first; READY waits for that as long as this."""


class Workers:
    """One process for each bus of a configuration."""

    def __init__(
        self,
        prepared: Prepared,
        segments: Segments,
        offsets: list[int],
        locks: tuple[int, ...],
        say: Callable[[str], None],
    ) -> None:
        """`offsets` (bytes) tell where each driver's context is in its segment."""
        wiring = prepared.wiring
        self._workers = [
            BusWorker(prepared, name, segments, offset, locks)
            for name, offset in zip(wiring.drivers, offsets, strict=True)
            if name in wiring.buses
        ]
        self._say = say
        self._supervising: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Self:
        """Start all and wait until every link is up; DeviceUnavailable where one does not come up."""
        try:
            for worker in self._workers:
                await worker.start(self._say)
            for worker in self._workers:
                await worker.first_link()
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
        left = [f"driver {worker.name}: {worker.outputs_told}" for worker in self._workers if not worker.rests]
        if left and value is None:
            raise CheckFailed(f"{'; '.join(left)}. See what its device puts out; then `micromanip safe-outputs`")
        for text in left:
            self._say(f"WARNING: {text}")

    async def in_hand(self, beat: Callable[[], None]) -> None:
        """Wait until all outputs follow the loop, giving a sign of life; what takes too long is told when arming."""
        end = time.monotonic() + _IN_HAND_S
        while time.monotonic() < end and not all(worker.is_followed for worker in self._workers):
            beat()
            await asyncio.sleep(_POLL_S)

    def adopt(self, prepared: Prepared) -> None:
        """Go by the limits and times of another configuration from now on."""
        for worker in self._workers:
            worker.adopt(prepared)

    def report(self) -> dict[str, Link]:
        """Where each link stands, by the driver's name."""
        return {worker.name: worker.report() for worker in self._workers}

    def outputs_told(self) -> dict[str, str]:
        """What people are told of the outputs of each driver with the loop dead."""
        return {worker.name: worker.outputs_told for worker in self._workers}
