"""Who is served, and when: so many clients of each user, one request at a time, and always those who stop the cell.

Whoever finds the ordinary slots taken sits in a reserved one for a moment and is answered one `disarm` or `hold`.
Nobody can keep a reserved slot: it is closed soon, and at once for a newcomer.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections.abc import AsyncIterator, Iterable
from dataclasses import dataclass, field

from micromanip.errors import DeviceUnavailable

from .authority import Peer

_number = itertools.count()
_REST_S = 0.02
"""Longest rest after a request: clients that ask without a pause get half of the host's time, however many."""


@dataclass(frozen=True)
class Bounds:
    """The numbers of one socket; times in s."""

    clients: int = 512
    """At a time; each takes a descriptor, of which a process usually has 1024."""
    of_a_user: int = 224
    reserved: int = 2
    idle_s: float = 60.0
    """A client that asks nothing for so long is closed."""
    reserved_s: float = 2.0
    """Time to ask, for one that has a reserved slot."""
    unread_s: float = 5.0
    """A client that leaves its answers unread for so long is cut off."""


@dataclass(eq=False)
class Client:
    """One connection; `waiting` until it has asked."""

    writer: asyncio.StreamWriter
    peer: Peer
    waiting: bool = True
    number: int = field(default_factory=lambda: next(_number))


class Slots:
    """Who is connected."""

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._ordinary: set[Client] = set()
        self._reserved: set[Client] = set()

    def enter(self, client: Client) -> DeviceUnavailable | None:
        """Give `client` a slot: None for an ordinary one, else why it has a reserved one only.

        Raises DeviceUnavailable where those who have the reserved ones are just being answered.
        """
        lack = self._lack(client.peer)
        if lack is None:
            self._ordinary.add(client)
            return None
        if len(self._reserved) >= self._bounds.reserved:
            self._make_room(lack)
        self._reserved.add(client)
        return lack

    def leave(self, client: Client) -> None:
        """Free its slot."""
        self._ordinary.discard(client)
        self._reserved.discard(client)

    def _lack(self, peer: Peer) -> DeviceUnavailable | None:
        if len(self._ordinary) >= self._bounds.clients:
            return DeviceUnavailable(f"{self._bounds.clients} clients are connected already; end one of them")
        if self._of(peer, self._ordinary) >= self._bounds.of_a_user:
            return DeviceUnavailable(
                f"{self._bounds.of_a_user} clients of {peer.user} are connected already; end one of them"
            )
        return None

    def _make_room(self, lack: DeviceUnavailable) -> None:
        """Close the reserved slot of the user who has most clients, the one who came first."""
        waiting = [client for client in self._reserved if client.waiting]
        if not waiting:
            raise lack
        everybody = self._ordinary | self._reserved
        victim = max(waiting, key=lambda client: (self._of(client.peer, everybody), -client.number))
        self._reserved.discard(victim)
        victim.writer.close()

    @staticmethod
    def _of(peer: Peer, clients: Iterable[Client]) -> int:
        return sum(client.peer.uid == peer.uid for client in clients)


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
