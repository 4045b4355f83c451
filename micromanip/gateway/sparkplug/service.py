"""The edge node beside the web pages: sessions with the broker, one after the other, as long as the gateway runs.

It shows what the gateway knows, and nothing that comes in reaches the controller. Whatever the broker does, the loop
and the pages go on; it is told once, and tried again after a second, later every minute.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.metadata
import time
from collections.abc import AsyncIterator, Callable

from ..cell import Cell, Rows
from ..readings import readings
from ..telling import Teller
from .commands import PrimaryHost, command
from .connection import Connection, Login, Lost
from .node import NUMBERS, EdgeNode
from .options import Options

_FIRST_S, _LONGEST_S = 1.0, 60.0
_REBIRTH_S = 1.0


class Sparkplug:
    """One edge node; `serving` is its life."""

    def __init__(self, cell: Cell, options: Options, say: Callable[[str], None]) -> None:
        """Raises ConfigError, PermissionDenied or UsageError where files that are named in `options` can't be used."""
        self._cell, self._options = cell, options
        context, password = options.context(), options.password()
        self._login = Login(options.host, options.port_used, options.user, password, context)
        self._say = Teller(say)
        self._version = importlib.metadata.version("micromanip")
        self._bd_seq = -1
        self._fresh = asyncio.Event()
        self._rest_s = _FIRST_S

    @property
    def name(self) -> str:
        """For people."""
        return f"{self._options.group}/{self._options.node} at {self._login.host}:{self._login.port}"

    @contextlib.asynccontextmanager
    async def serving(self) -> AsyncIterator[None]:
        """Serve meanwhile."""
        keeping = asyncio.create_task(self._keep())
        self._cell.listeners.add(self._heard)
        try:
            yield
        finally:
            self._cell.listeners.discard(self._heard)
            keeping.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await keeping

    def _heard(self, rows: Rows | None) -> None:
        if rows is None:
            self._fresh.set()

    async def _keep(self) -> None:
        while True:
            begun_s = time.monotonic()
            try:
                await self._session()
            except (Lost, OSError, RuntimeError, ValueError) as problem:
                self._say.state(f"MQTT {self.name}: {problem}; it is tried again, from now on in silence")
            if time.monotonic() - begun_s > _LONGEST_S:
                self._rest_s = _FIRST_S
            await asyncio.sleep(self._rest_s)
            self._rest_s = min(_LONGEST_S, 2.0 * self._rest_s)

    async def _session(self) -> None:
        """From connecting to the end of the connection, or until the primary host is gone."""
        self._bd_seq = (self._bd_seq + 1) % NUMBERS
        node = EdgeNode(self._options, self._bd_seq)
        host = None if self._options.primary_host is None else PrimaryHost(self._options.primary_host)
        connection = Connection(self._login, node.death(_now_ms()), self._options.client)
        topics = [node.topic("NCMD"), node.topic("DCMD", "#"), *([host.topic] if host is not None else [])]
        try:
            await connection.open(topics)
            while host is not None and not host.is_online:
                self._say.state(f"MQTT {self.name}: connected; waits for the primary host {self._options.primary_host}")
                heard = await connection.heard()
                if heard.topic == host.topic:
                    host.hear(heard.payload)
            self._say.state(f"MQTT {self.name}: connected")
            await self._publish(connection, node, host)
        finally:
            await connection.close(node.death(_now_ms()))

    async def _publish(self, connection: Connection, node: EdgeNode, host: PrimaryHost | None) -> None:
        """Births, then what changes; commands meanwhile. It returns where the primary host goes away."""
        asked = True
        listening = asyncio.create_task(connection.heard())
        try:
            while True:
                if asked:
                    for message in node.birth(readings(self._cell, self._version), _now_ms()):
                        connection.publish(message)
                elif self._fresh.is_set() and not connection.is_stuck:
                    self._fresh.clear()
                    for message in node.changes(readings(self._cell, self._version), _now_ms()):
                        connection.publish(message)
                asked = False
                begun_s = time.monotonic()
                next_s = begun_s + self._options.period_s
                while (left_s := next_s - time.monotonic()) > 0:
                    if not (await asyncio.wait({listening}, timeout=left_s))[0]:
                        continue
                    heard = listening.result()
                    listening = asyncio.create_task(connection.heard())
                    if host is not None and heard.topic == host.topic:
                        host.hear(heard.payload)
                        if not host.is_online:
                            return
                    elif heard.topic.split("/")[2:3] in (["NCMD"], ["DCMD"]):
                        asked |= self._commanded(heard.topic, heard.payload)
                        if asked:
                            next_s = min(next_s, begun_s + _REBIRTH_S)
        finally:
            listening.cancel()
            with contextlib.suppress(asyncio.CancelledError, Lost):
                await listening

    def _commanded(self, topic: str, content: bytes) -> bool:
        """Whether a rebirth is asked for; all else is told and ignored."""
        heard = command(topic, content)
        if heard.ignored is not None:
            self._say.event(f"MQTT {self.name}: ignored {heard.ignored}: nothing is written by MQTT")
        return heard.asks_rebirth


def _now_ms() -> int:
    return time.time_ns() // 1_000_000
