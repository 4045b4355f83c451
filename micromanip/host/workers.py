"""All driver workers of a controller."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Self

from micromanip.answers import Link
from micromanip.settings.check import Prepared

from .bus_worker import BusWorker
from .segments import Segments


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
        except BaseException:
            await self.__aexit__()
            raise
        self._supervising = [asyncio.create_task(worker.supervise(self._say)) for worker in self._workers]
        return self

    async def __aexit__(self, *_: object) -> None:
        """End all, with their outputs at rest."""
        await asyncio.gather(*(worker.end() for worker in self._workers))
        for task in self._supervising:
            task.cancel()

    def report(self) -> dict[str, Link]:
        """Where each link stands, by the driver's name."""
        return {worker.name: worker.report() for worker in self._workers}
