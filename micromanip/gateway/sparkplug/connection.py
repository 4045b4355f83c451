"""One connection to a broker: paho's threads do the network, what happens comes as events into the gateway's loop."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import threading
from dataclasses import dataclass
from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from .node import Message
from .tls_refusals import keeping, told

_KEEP_ALIVE_S = 30
_OPEN_S, _LEAVE_S = 15.0, 2.0
_UNKNOWN = "Unspecified error"
_MOST_EVENTS = 256
"""What comes faster than it is looked at is dropped: it is commands that are ignored, or state that is said again."""


class Lost(Exception):  # noqa: N818
    """The connection is over, or never was; the text says why."""


@dataclass(frozen=True)
class Login:
    """Where to, and as whom."""

    host: str
    port: int
    user: str | None = None
    password: str | None = None
    context: ssl.SSLContext | None = None


class Connection:
    """`open` it once; then `publish`, `heard`, `close`."""

    def __init__(self, login: Login, will: Message, name: str) -> None:
        """`name` is ours there: a broker ends the session of another one of that name, and says its will before."""
        self._login = login
        self._loop = asyncio.get_running_loop()
        self._events: asyncio.Queue[Lost | Message] = asyncio.Queue(_MOST_EVENTS)
        self._opened: asyncio.Future[None] = self._loop.create_future()
        self._subscribed = asyncio.Event()
        self._refusals: list[str] = []
        self._client = client = Client(
            CallbackAPIVersion.VERSION2, name, clean_session=True, reconnect_on_failure=False
        )
        client.suppress_exceptions = True
        if login.user is not None:
            client.username_pw_set(login.user, login.password)
        if login.context is not None:
            login.context.sslsocket_class = keeping(self._refusals)
            client.tls_set_context(login.context)
        client.will_set(will.topic, will.payload, qos=1)
        client.on_connect = self._on_connect
        client.on_subscribe = lambda *_: self._from_thread(self._subscribed.set)
        client.on_disconnect = lambda _c, _u, _f, reason, _p: self._from_thread(self._ended, str(reason))
        client.on_message = lambda _c, _u, m: self._from_thread(self._put, Message(m.topic, bytes(m.payload)))

    async def open(self, topics: list[str]) -> None:
        """Connect, and subscribe to `topics`; Lost where that fails or takes too long."""
        threading.Thread(target=self._connect, name="mqtt", daemon=True).start()
        try:
            async with asyncio.timeout(_OPEN_S):
                await self._opened
                self._client.subscribe([(topic, 1) for topic in topics])
                await self._subscribed.wait()
        except TimeoutError:
            raise Lost("no answer") from None

    def publish(self, message: Message, qos: int = 0) -> None:
        """Hand it over; it is on its way later."""
        self._client.publish(message.topic, message.payload, qos)

    @property
    def is_stuck(self) -> bool:
        """Whether the broker has not taken yet what was published before."""
        return self._client.want_write()

    async def heard(self) -> Message:
        """The next message; Lost once the connection is over."""
        event = await self._events.get()
        if isinstance(event, Lost):
            raise event
        return event

    async def close(self, last: Message | None) -> None:
        """Say `last` where the connection is still there, and leave."""
        self._client.on_message = None
        if self._client.is_connected() and last is not None:
            sent = self._client.publish(last.topic, last.payload, 1)
            with contextlib.suppress(RuntimeError, TimeoutError):  # RuntimeError: the connection was lost meanwhile
                async with asyncio.timeout(_LEAVE_S):
                    while self._client.is_connected() and not sent.is_published():
                        await asyncio.sleep(0.02)
        self._client.disconnect()

    def _connect(self) -> None:
        try:
            self._client.connect(self._login.host, self._login.port, _KEEP_ALIVE_S)
            self._client.loop_start()
        except ssl.SSLError as problem:
            self._from_thread(self._over, told(problem))
        except (OSError, ValueError) as problem:
            self._from_thread(self._over, str(getattr(problem, "strerror", None) or problem))

    def _on_connect(self, _client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        self._from_thread(self._answered, str(reason) if reason.is_failure else None)

    def _from_thread(self, call: Any, *arguments: Any) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(call, *arguments)

    def _answered(self, refused: str | None) -> None:
        if refused is not None:
            self._over(refused)
        elif not self._opened.done():
            self._opened.set_result(None)

    def _ended(self, reason: str) -> None:
        """By the broker or the network; `reason` is what paho calls it."""
        if self._refusals:
            self._over(self._refusals[0])
        elif reason != _UNKNOWN:
            self._over(reason)
        elif self._opened.done():
            self._over("the connection was lost")
        else:
            asks = "does it ask for a certificate, tls.certificate, or not take ours?"
            hint = "is it a port for TLS?" if self._login.context is None else asks
            self._over(f"it ended the connection without an answer: {hint}")

    def _over(self, why: str) -> None:
        if not self._opened.done():
            self._opened.set_exception(Lost(why))
        while self._events.full():
            self._events.get_nowait()
        self._events.put_nowait(Lost(why))

    def _put(self, message: Message) -> None:
        if not self._events.full():
            self._events.put_nowait(message)
