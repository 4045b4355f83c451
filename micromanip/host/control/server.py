"""The control socket: versioned lines of JSON, each a request for a verb, from any number of clients.

-> {"version": 1, "verb": "status"}
<- {"version": 1, "ok": true, "result": {...}}
<- {"version": 1, "ok": false, "error": "arm refused: the state is FAULT", "exit_code": 1}

Nobody can hold up the host's own work: at most one request begins between two turns of the event loop, and
a client that does not take its answers is dropped. Nobody can keep others from stopping the cell: see ``admission``.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import math
import re
import traceback
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from pydantic import BaseModel

from micromanip.errors import ConfigError, DeviceUnavailable, MicromanipError, UsageError, system_error
from micromanip.settings.load import validate_section
from micromanip.settings.schema.base import Settings
from micromanip.settings.text.source import Source

from .admission import Bounds, Client, Slots, Turns
from .authority import Authority, Peer, Right
from .handover import Handed, send
from .socket_file import Access, bound, claim

VERSION = 1
LINE_BYTES = 65536
_DEPTH = 32
_NAME = re.compile(r"[\w.@ -]{1,60}", re.ASCII)
"""In whose name somebody asks, who has let them in by other means: it is noted, and gives no right."""

Fields = TypeVar("Fields", bound=BaseModel)


class Nothing(Settings):
    """Fields of a verb that takes none."""


@dataclass(frozen=True)
class Request:
    """One line of a client: the verb and what it is given."""

    verb: str
    fields: dict[str, Any]
    peer: Peer

    def read(self, model: type[Fields]) -> Fields:
        """The fields, validated; UsageError where one is unknown, missing or wrong."""
        try:
            source = Source(Path(self.verb), "", self.fields, {}, in_file=False)
            return validate_section(source, (), model, self.fields)
        except ConfigError as problem:
            raise UsageError(f"{self.verb}: {problem}") from None


Act = Callable[[Request], Awaitable[Any]]


@dataclass(frozen=True)
class Verb:
    """What a client can ask for: what is done, and the right that it takes."""

    act: Act
    right: Callable[[Request], Right]
    stops: bool = False
    """It only ever brings the cell nearer to rest: it is answered also where there is no room for anything else."""

    async def __call__(self, request: Request) -> Any:
        return await self.act(request)


def observing(act: Act) -> Verb:
    """A verb that changes nothing."""
    return Verb(act, lambda _: Right.OBSERVE)


def operating(act: Act, *, stops: bool = False) -> Verb:
    """A verb that moves something, or changes what runs or is kept."""
    return Verb(act, lambda _: Right.OPERATE, stops)


def parsed(line: bytes, peer: Peer) -> Request:
    """The request in `line`; UsageError where there is none."""
    try:
        document = json.loads(line, parse_constant=_no_number, parse_float=_finite)
    except (ValueError, RecursionError) as problem:  # not only JSONDecodeError: a number may be too long
        raise UsageError(f"not a line of JSON: {problem}") from problem
    if line.count(b"[") + line.count(b"{") > _DEPTH and _is_deeper(document, _DEPTH):
        raise UsageError(f"a request is nested at most {_DEPTH} deep")
    if not isinstance(document, dict) or "version" not in document:
        raise UsageError(f'a request is a JSON object with "version": {VERSION}')
    version = document.pop("version")
    if version != VERSION or not isinstance(version, int) or isinstance(version, bool):
        raise UsageError(f"version {version!r:.40} of the protocol is not supported; supported is {VERSION}")
    verb = document.pop("verb", None)
    if not isinstance(verb, str):
        raise UsageError(f"a verb is a text, not {verb!r:.40}")
    behalf = document.pop("on_behalf_of", None)
    if behalf is not None:
        if not isinstance(behalf, str) or not _NAME.fullmatch(behalf):
            raise UsageError(f"on_behalf_of is a name of 1 to 60 letters, digits, spaces and _.@-, not {behalf!r:.80}")
        peer = dataclasses.replace(peer, user=f"{peer.user} for {behalf}")
    return Request(verb, document, peer)


def _is_deeper(document: Any, depth: int) -> bool:
    level = [document]
    for _ in range(depth):
        level = [entry for part in level if isinstance(part, dict | list) for entry in _entries(part)]
    return bool(level)


def _entries(part: dict[str, Any] | list[Any]) -> Iterable[Any]:
    return part.values() if isinstance(part, dict) else part


def _no_number(name: str) -> NoReturn:
    raise UsageError(f"expected finite numbers, not {name:.20}; where no limit is meant, null says so")


def _finite(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _no_number(text)


def success(result: Any) -> bytes:
    """The answer of a verb that did what was asked."""
    return _line({"version": VERSION, "ok": True, "result": result})


def failure(problem: MicromanipError) -> bytes:
    """The answer of one that did not."""
    return _line({"version": VERSION, "ok": False, "error": str(problem), "exit_code": problem.exit_code})


def _line(answer: dict[str, Any]) -> bytes:
    return json.dumps(answer).encode() + b"\n"


Refused = Callable[[Peer, str, str], Awaitable[None]]
"""Hears of each refusal of the socket itself: by whom, the verb, why."""

_ACCESS, _BOUNDS = Access(), Bounds()
_NO_VERB = "?"
_URGENT_BYTES = 1000
"""A request to stop is short, and worth being read before its turn."""


async def _nobody(_peer: Peer, _verb: str, _why: str) -> None:
    pass


class ControlSocket:
    """Serves `verbs`; none of its clients can hold up another, or the host."""

    def __init__(
        self,
        path: Path,
        verbs: Mapping[str, Verb],
        access: Access = _ACCESS,
        bounds: Bounds = _BOUNDS,
        refused: Refused = _nobody,
    ) -> None:
        self.path = path
        self._verbs = verbs
        self._access, self._bounds, self._refused = access, bounds, refused
        self._authority = Authority(-1)
        self._server: asyncio.AbstractServer | None = None
        self._slots = Slots(bounds)
        self._turns, self._stops = Turns(), Turns()

    async def open(self) -> None:
        """Listen; raises CheckFailed or UsageError where it can't."""
        try:
            claim(self.path)
            listening, self._authority = bound(self.path, self._access)
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
                send(client.writer.get_extra_info("socket"), success(handed.result), descriptors)
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
            self._authority.demand(peer, verb.right(request), name)
        except MicromanipError as problem:
            await self._refused(peer, name, str(problem))
            return failure(problem)
        try:
            result = await verb(request)
            return result if isinstance(result, Handed) else success(result)
        except MicromanipError as problem:
            return failure(problem)
        except OSError as problem:
            return failure(system_error(problem))
        except Exception as bug:
            traceback.print_exc()
            return failure(MicromanipError(f"bug: {type(bug).__name__}: {bug}; the controller's log has the rest"))

    def _verb(self, request: Request) -> Verb:
        verb = self._verbs.get(request.verb)
        if verb is None:
            raise UsageError(f"unknown verb {request.verb!r:.60}; known are {', '.join(sorted(self._verbs))}")
        return verb
