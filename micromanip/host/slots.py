"""How many clients a control socket serves: some for each user, and two more for those who come to stop the cell.

Whoever finds the ordinary slots taken sits in a reserved one for a moment and is answered one `disarm` or `hold`.
Nobody can keep a reserved slot: it is closed soon, and at once for a newcomer.
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Iterable
from dataclasses import dataclass, field

from micromanip.errors import DeviceUnavailable

from .peer import Peer

_number = itertools.count()


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
