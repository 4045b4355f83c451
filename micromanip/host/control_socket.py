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

Verb = Callable[[dict[str, Any]], Awaitable[Any]]


def claim(path: Path) -> None:
    """Make room for the socket: its folder exists, and no living daemon answers on it.

    Raises CheckFailed where one does; a stale socket of a dead one is removed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            path.unlink(missing_ok=True)
            return
    raise CheckFailed(f"another controller answers on {path}; stop it first, or choose another --socket")


class ControlSocket:
    """Serves `verbs` to any number of clients; none of them can hold up another, or the loop."""

    def __init__(self, path: Path, verbs: dict[str, Verb]) -> None:
        self.path = path
        self._verbs = verbs
        self._server: asyncio.AbstractServer | None = None

    async def open(self) -> None:
        """Listen, for the owner and the owner's group only."""
        claim(self.path)
        self._server = await asyncio.start_unix_server(self._serve, str(self.path), limit=_LINE_BYTES)
        os.chmod(self.path, 0o660)  # noqa: PTH101

    def close(self) -> None:
        """Stop listening and remove the socket."""
        if self._server is not None:
            self._server.close()
        self.path.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError, asyncio.CancelledError):
            while True:
                try:
                    line = await reader.readline()
                except ValueError:
                    writer.write(_line(_failure(UsageError(f"a request is at most {_LINE_BYTES} bytes long"))))
                    await writer.drain()
                    break
                if not line:
                    break
                writer.write(_line(await self._answer(line)))
                await writer.drain()
        with contextlib.suppress(ConnectionError):
            writer.close()

    async def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            if not isinstance(request, dict) or request.get("version") != VERSION:
                raise UsageError(f'a request is a JSON object with "version": {VERSION}')
            verb = self._verbs.get(str(request.get("verb")))
            if verb is None:
                raise UsageError(f"unknown verb {request.get('verb')!r}; known are {', '.join(sorted(self._verbs))}")
            return {"version": VERSION, "ok": True, "result": await verb(request)}
        except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as problem:
            return _failure(UsageError(f"not a line of JSON: {problem}"))
        except MicromanipError as problem:
            return _failure(problem)


def _failure(problem: MicromanipError) -> dict[str, Any]:
    return {"version": VERSION, "ok": False, "error": str(problem), "exit_code": problem.exit_code}


def _line(answer: dict[str, Any]) -> bytes:
    return json.dumps(answer).encode() + b"\n"
