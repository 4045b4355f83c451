"""The control socket: versioned JSON lines over a Unix socket.

-> {"version": 1, "verb": "status"}
<- {"version": 1, "ok": true, "result": {...}}
<- {"version": 1, "ok": false, "error": "arm refused: the state is FAULT", "exit_code": 1}
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from micromanip.errors import CheckFailed, MicromanipError, UsageError

VERSION = 1
_LINE_BYTES = 65536
_ANSWER_S = 1.0

Verb = Callable[[dict[str, Any]], Awaitable[Any]]


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


class ControlSocket:
    """Serves `verbs` to any number of clients; none of them can hold up another, or the loop."""

    def __init__(self, path: Path, verbs: dict[str, Verb]) -> None:
        self.path = path
        self._verbs = verbs
        self._server: asyncio.AbstractServer | None = None

    async def open(self) -> None:
        """Listen, for the owner and the owner's group only; raises CheckFailed or UsageError where it can't."""
        try:
            claim(self.path)
            self._server = await asyncio.start_unix_server(self._serve, str(self.path), limit=_LINE_BYTES)
            os.chmod(self.path, 0o660)  # noqa: PTH101
        except OSError as problem:
            raise UsageError(f"no control socket at {self.path}: {problem}; choose another --socket") from problem

    def close(self) -> None:
        """Stop listening and remove the socket."""
        if self._server is not None:
            self._server.close()
        self.path.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(asyncio.CancelledError):
            with contextlib.suppress(ConnectionError):
                await self._converse(reader, writer)
            writer.close()
            with contextlib.suppress(ConnectionError):  # taken note of, or it may be reported as forgotten
                await writer.wait_closed()
        writer.close()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            try:
                line = await reader.readline()
            except ValueError:
                writer.write(_line(_failure(UsageError(f"a request is at most {_LINE_BYTES} bytes long"))))
                await writer.drain()
                return
            if not line:
                return
            writer.write(_line(await self._answer(line)))
            await writer.drain()

    async def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = _parsed(line)
            if not isinstance(request, dict) or request.get("version") != VERSION:
                raise UsageError(f'a request is a JSON object with "version": {VERSION}')
            verb = self._verbs.get(str(request.get("verb")))
            if verb is None:
                raise UsageError(f"unknown verb {request.get('verb')!r}; known are {', '.join(sorted(self._verbs))}")
            return {"version": VERSION, "ok": True, "result": await verb(request)}
        except MicromanipError as problem:
            return _failure(problem)


def _parsed(line: bytes) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as problem:  # not only JSONDecodeError: a number may be too long
        raise UsageError(f"not a line of JSON: {problem}") from problem


def _failure(problem: MicromanipError) -> dict[str, Any]:
    return {"version": VERSION, "ok": False, "error": str(problem), "exit_code": problem.exit_code}


def _line(answer: dict[str, Any]) -> bytes:
    return json.dumps(answer).encode() + b"\n"
