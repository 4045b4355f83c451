"""The control socket: a Unix socket that serves verbs to any number of clients, one line each at a time.

Nobody can hold up the host's own work: at most one request begins between two turns of the event loop, and
a client that does not take its answers is dropped.
"""

from __future__ import annotations

import asyncio
import contextlib
import grp
import os
import socket
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from micromanip.errors import CheckFailed, DeviceUnavailable, MicromanipError, PermissionDenied, UsageError

from .peer import Peer
from .protocol import LINE_BYTES, Request, Verb, failure, parsed, success

CLIENTS = 256
UNREAD_S = 5.0
_REST_S = 0.02
"""Longest rest after a request: clients that ask without a pause get half of the host's time, however many."""
_ANSWER_S = 1.0


@dataclass(frozen=True)
class Access:
    """Who may connect: permissions of the socket, and the group it is given to."""

    mode: int = 0o660
    group: str | None = None


@dataclass(frozen=True)
class Bounds:
    """How many clients at a time, and how long one may leave its answers unread (s)."""

    clients: int = CLIENTS
    unread_s: float = UNREAD_S


def claim(path: Path) -> None:
    """Make room for the socket: its folder exists, and no living daemon answers on it.

    Raises CheckFailed where one does, or where the path is anything but a dead one's socket.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_stale(path)
    if path.is_socket():
        raise CheckFailed(f"another controller answers on {path}; stop it first, or choose another --socket")
    if path.exists() or path.is_symlink():
        raise CheckFailed(f"{path} is not a socket and stays as it is; choose another --socket")


def remove_stale(path: Path) -> None:
    """Remove the socket of a dead daemon; whatever else is there is left alone."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe, contextlib.suppress(OSError):
        probe.settimeout(_ANSWER_S)  # of one that lives, but does not answer
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            if path.is_socket():
                path.unlink()


def bound(path: Path, access: Access) -> socket.socket:
    """A socket bound at `path` that is at no moment open to more than `access` says; OSError where it can't be."""
    group = None if access.group is None else _group_id(access.group)
    bound = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    before = os.umask(0o177)
    try:
        bound.bind(str(path))
    except OSError:
        bound.close()
        raise
    finally:
        os.umask(before)
    if group is not None:
        try:
            os.chown(path, -1, group)
        except PermissionError:
            bound.close()
            path.unlink()
            raise PermissionDenied(
                f"control.group: the socket can't be given to {access.group}; the controller's user must be a member"
            ) from None
    path.chmod(access.mode)
    return bound


def _group_id(name: str) -> int:
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        raise UsageError(
            f"control.group: there is no group {name} on this machine; `groupadd {name}` makes it"
        ) from None


class ControlSocket:
    """Serves `verbs`; none of its clients can hold up another, or the host."""

    def __init__(
        self, path: Path, verbs: Mapping[str, Verb], access: Access = Access(), bounds: Bounds = Bounds()
    ) -> None:
        self.path = path
        self._verbs = verbs
        self._access, self._bounds = access, bounds
        self._server: asyncio.AbstractServer | None = None
        self._clients: set[asyncio.StreamWriter] = set()
        self._turn = asyncio.Lock()
        self._rested = 0.0

    async def open(self) -> None:
        """Listen; raises CheckFailed or UsageError where it can't."""
        try:
            claim(self.path)
            listening = bound(self.path, self._access)
            self._server = await asyncio.start_unix_server(self._serve, sock=listening, limit=LINE_BYTES)
        except OSError as problem:
            raise UsageError(f"no control socket at {self.path}: {problem}; choose another --socket") from problem

    def close(self) -> None:
        """Stop listening and remove the socket."""
        if self._server is not None:
            self._server.close()
        self.path.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(asyncio.CancelledError):
            self._clients.add(writer)
            try:
                with contextlib.suppress(ConnectionError):
                    await self._converse(reader, writer)
            except TimeoutError:
                writer.transport.abort()  # what it has not read is thrown away
            finally:
                self._clients.discard(writer)
            writer.close()
            with contextlib.suppress(ConnectionError):  # taken note of, or it may be reported as forgotten
                await writer.wait_closed()
        writer.close()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._clients) > self._bounds.clients:
            number = self._bounds.clients
            await self._say(
                writer, failure(DeviceUnavailable(f"{number} clients are connected already; end one of them"))
            )
            return
        peer = Peer.of(writer.get_extra_info("socket"))
        while True:
            try:
                line = await reader.readline()
            except ValueError:
                await self._say(writer, failure(UsageError(f"a request is at most {LINE_BYTES} bytes long")))
                return
            if not line:
                return
            await self._turn_of_all()
            begin = time.monotonic()
            answer = await self._answer(line, peer)
            now = time.monotonic()
            self._rested = max(self._rested, now + min(now - begin, _REST_S))
            await self._say(writer, answer)

    async def _turn_of_all(self) -> None:
        """Return when the next request may begin: whatever else is due comes first, and after each a rest as long."""
        async with self._turn:
            await asyncio.sleep(max(0.0, self._rested - time.monotonic()))

    async def _say(self, writer: asyncio.StreamWriter, answer: bytes) -> None:
        writer.write(answer)
        async with asyncio.timeout(self._bounds.unread_s):
            await writer.drain()

    async def _answer(self, line: bytes, peer: Peer) -> bytes:
        try:
            request = parsed(line, peer)
            return success(await self._verb(request)(request))
        except MicromanipError as problem:
            return failure(problem)
        except Exception as bug:
            traceback.print_exc()
            return failure(MicromanipError(f"bug: {type(bug).__name__}: {bug}; the controller's log has the rest"))

    def _verb(self, request: Request) -> Verb:
        verb = self._verbs.get(request.verb)
        if verb is None:
            raise UsageError(f"unknown verb {request.verb!r:.60}; known are {', '.join(sorted(self._verbs))}")
        return verb
