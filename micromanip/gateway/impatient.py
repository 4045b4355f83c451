"""HTTP connections that ask for nothing: they are closed, so that none is missing for whoever has an order to give."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_SOCKETS = 400
"""With more than so many the one that has been idle longest is closed: a process has some 1,000 descriptors."""
HEADERS_S = 10.0
"""A connection must have asked for something whole within this time."""


class Impatient(H11Protocol):
    """The server's end of one connection."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._waits: asyncio.TimerHandle | None = None
        self._begun_s = self.loop.time()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for its first request, and make room for it."""
        super().connection_made(transport)
        self._waits = self.loop.call_later(HEADERS_S, self._leave_if_idle)
        idle = [each for each in self.connections if isinstance(each, Impatient) and each is not self and each.is_idle]
        if len(self.connections) > MOST_SOCKETS and idle:
            min(idle, key=lambda each: each._begun_s).transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is waited for any more."""
        if self._waits is not None:
            self._waits.cancel()
        super().connection_lost(exc)

    @property
    def is_idle(self) -> bool:
        """Whether no request of it is under way; one that has become a WebSocket is none of ours."""
        cycle = self.cycle
        mine = self.transport.get_protocol() is self
        return mine and (cycle is None or cycle.response_complete)

    def data_received(self, data: bytes) -> None:
        """A piece of a request: while it is not whole the time goes on from its beginning."""
        if self.is_idle and (self._waits is None or self._waits.when() < self.loop.time()):
            self._waits = self.loop.call_later(HEADERS_S, self._leave_if_idle)
        super().data_received(data)

    def _leave_if_idle(self) -> None:
        if self.is_idle and not self.transport.is_closing():
            self.transport.close()
