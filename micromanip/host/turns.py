"""Turns of one event loop: who has work to do takes one, and rests as long as its work took."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator

_REST_S = 0.02
"""Longest rest after a request: clients that ask without a pause get half of the host's time, however many."""


class Turns:
    """One queue: at most one piece of work begins between two turns of the event loop."""

    def __init__(self) -> None:
        self._turn = asyncio.Lock()
        self._rested = 0.0

    @contextlib.asynccontextmanager
    async def one(self) -> AsyncIterator[None]:
        """Enter when the next may begin: whatever else is due comes first, and after each a rest as long."""
        async with self._turn:
            await asyncio.sleep(max(0.0, self._rested - time.monotonic()))
        begin = time.monotonic()
        try:
            yield
        finally:
            now = time.monotonic()
            self._rested = max(self._rested, now + min(now - begin, _REST_S))
