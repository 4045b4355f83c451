"""The control socket: lines of JSON (``request.py``) from any number of clients.

Nobody can hold up the host's own work: at most one request begins between two turns of the event loop, and
a client that does not take its answers is dropped. Nobody can keep others from stopping the cell: see ``admission``.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import traceback
from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from micromanip.errors import DeviceUnavailable, MicromanipError, UsageError, system_error

from .admission import Bounds, Client, Slots, Turns
from .authority import Authority, Peer
from .request import Request, Verb, failure, parsed, success
from .socket_file import Access, bound, claim

LINE_BYTES = 65536

Refused = Callable[[Peer, str, str], Awaitable[None]]
"""Hears of each refusal of the socket itself: by whom, the verb, why."""

_ACCESS, _BOUNDS = Access(), Bounds()
_NO_VERB = "?"
_URGENT_BYTES = 1000
"""A request to stop is short, and worth being read before its turn."""


async def _nobody(_peer: Peer, _verb: str, _why: str) -> None:
    pass


@dataclass(frozen=True)
class Handed:
    """A result, and descriptors that go with it, with the answer's own line by SCM_RIGHTS: the server's to close."""

    result: Any
    descriptors: tuple[int, ...]

    @contextlib.contextmanager
    def held(self) -> Iterator[tuple[int, ...]]:
        """The descriptors, closed afterwards."""
        try:
            yield self.descriptors
        finally:
            for descriptor in self.descriptors:
                os.close(descriptor)


class ControlSocket:
    """Serves `verbs`; none of its clients can hold up another, or the host."""

    def __init__(
        self,
        path: Path,
        verbs: Mapping[str, Verb],
        access: Access = _ACCESS,
        bounds: Bounds = _BOUNDS,
        refused: Refused = _nobody,
        failed: Callable[[BaseException], object] = lambda _: None,
    ) -> None:
        """`failed` hears of an error that no verb should have."""
        self.path = path
        self._verbs = verbs
        self._access, self._bounds, self._refused, self._failed = access, bounds, refused, failed
        self._authority = Authority(-1)
        self._server: asyncio.AbstractServer | None = None
        self._slots = Slots(bounds)
        self._turns, self._stops = Turns(), Turns()

    async def open(self) -> None:
        """Listen; raises CheckFailed, UsageError, PermissionDenied or DeviceUnavailable where it can't."""
        try:
            claim(self.path)
            listening, self._authority = bound(self.path, self._access)
            self._server = await asyncio.start_unix_server(self._serve, sock=listening, limit=LINE_BYTES)
        except OSError as problem:
            refused = system_error(problem, f"no control socket at {self.path}")
            if problem.errno is None or isinstance(refused, UsageError):  # None: too long for a socket
                refused = UsageError(f"no control socket at {self.path}: {problem}; choose another --socket")
            raise refused from problem

    def close(self) -> None:
        """Stop listening and remove the socket."""
        if self._server is not None:
            self._server.close()
        self.path.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(asyncio.CancelledError):
            client = Client(writer, Peer.of(writer.get_extra_info("socket")))
            try:
                with contextlib.suppress(ConnectionError):
                    await self._admit(reader, client)
            except TimeoutError:
                writer.transport.abort()  # what it has not read is thrown away
            finally:
                self._slots.leave(client)
            writer.close()
            with contextlib.suppress(ConnectionError):  # taken note of, or it may be reported as forgotten
                await writer.wait_closed()
        writer.close()

    async def _admit(self, reader: asyncio.StreamReader, client: Client) -> None:
        try:
            lack = self._slots.enter(client)
        except DeviceUnavailable as full:
            await self._turn_away(client, full)
            return
        if lack is None:
            await self._converse(reader, client)
        else:
            await self._hear_once(reader, client, lack)

    async def _converse(self, reader: asyncio.StreamReader, client: Client) -> None:
        """Answer line after line, until the client goes or asks nothing any more."""
        while True:
            try:
                line = await self._line(reader, self._bounds.idle_s)
            except TimeoutError:
                await self._say(client, failure(DeviceUnavailable(f"closed: no request in {self._bounds.idle_s:g} s")))
                return
            except ValueError:
                problem = UsageError(f"a request is at most {LINE_BYTES} bytes long")
                await self._refused(client.peer, _NO_VERB, str(problem))
                await self._say(client, failure(problem))
                return
            if not line:
                return
            await self._answer_in(self._stops if self._stop_in(line, client.peer) else self._turns, line, client)

    async def _hear_once(self, reader: asyncio.StreamReader, client: Client, lack: DeviceUnavailable) -> None:
        """Answer one line where it stops the cell; `lack` is why there is no room for anything else."""
        try:
            line = await self._line(reader, self._bounds.reserved_s)
        except (TimeoutError, ValueError):
            await self._turn_away(client, lack)
            return
        client.waiting = False
        if line and not self._stop_in(line, client.peer):
            await self._turn_away(client, lack)
        elif line:
            await self._answer_in(self._stops, line, client)

    async def _answer_in(self, turns: Turns, line: bytes, client: Client) -> None:
        async with turns.one():
            answer = await self._answer(line, client.peer)
        if isinstance(answer, Handed):
            await self._hand(client, answer)
        else:
            await self._say(client, answer)

    async def _turn_away(self, client: Client, lack: DeviceUnavailable) -> None:
        await self._refused(client.peer, "connect", str(lack))
        await self._say(client, failure(lack))

    @staticmethod
    async def _line(reader: asyncio.StreamReader, patience_s: float) -> bytes:
        """The next line, empty at the end; TimeoutError where it is not complete in time, ValueError if too long."""
        async with asyncio.timeout(patience_s):
            return await reader.readline()

    async def _say(self, client: Client, answer: bytes) -> None:
        client.writer.write(answer)
        async with asyncio.timeout(self._bounds.unread_s):
            await client.writer.drain()

    async def _hand(self, client: Client, handed: Handed) -> None:
        with handed.held() as descriptors:
            if client.writer.transport.get_write_buffer_size() > 0:
                raise TimeoutError
            try:
                _send(client.writer.get_extra_info("socket"), success(handed.result), descriptors)
            except DeviceUnavailable as problem:
                raise TimeoutError from problem

    def _stop_in(self, line: bytes, peer: Peer) -> bool:
        """Whether `line` is a short request to stop."""
        if len(line) > _URGENT_BYTES:
            return False
        try:
            return self._verb(parsed(line, peer)).stops
        except UsageError:
            return False

    async def _answer(self, line: bytes, peer: Peer) -> bytes | Handed:
        name = _NO_VERB
        try:
            request = parsed(line, peer)
            name = request.verb
            verb = self._verb(request)
            peer = request.peer
            self._authority.demand(peer, verb.right, name)
        except MicromanipError as problem:
            await self._refused(peer, name, str(problem))
            return failure(problem)
        try:
            result = await verb.act(request)
            return result if isinstance(result, Handed) else success(result)
        except MicromanipError as problem:
            return failure(problem)
        except OSError as problem:
            return failure(system_error(problem))
        except Exception as bug:
            self._failed(bug)
            traceback.print_exc()
            return failure(MicromanipError(f"bug: {type(bug).__name__}: {bug}; the controller's log has the rest"))

    def _verb(self, request: Request) -> Verb:
        verb = self._verbs.get(request.verb)
        if verb is None:
            raise UsageError(f"unknown verb {request.verb!r:.60}; known are {', '.join(sorted(self._verbs))}")
        return verb


def _send(connection: Any, line: bytes, descriptors: tuple[int, ...]) -> None:
    """Send `line` with `descriptors` on the socket of a transport that has nothing else to send.

    Raises DeviceUnavailable where the client has left too much unread to take it in one piece.
    """
    with socket.socket(fileno=os.dup(connection.fileno())) as own:  # a transport's socket has no sendmsg
        try:
            sent = socket.send_fds(own, [line], descriptors)
        except BlockingIOError:
            sent = 0
    if sent != len(line):
        raise DeviceUnavailable("the client takes no answers")
