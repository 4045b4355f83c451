"""One line of JSON of the control socket: the request in it, what may be asked for, and the line that answers.

-> {"version": 1, "verb": "status"}
<- {"version": 1, "ok": true, "result": {...}}
<- {"version": 1, "ok": false, "error": "arm refused: the state is FAULT", "exit_code": 1}
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from pydantic import BaseModel

from micromanip.errors import ConfigError, MicromanipError, UsageError
from micromanip.settings.load import validate_section
from micromanip.settings.text.source import Source

from .authority import Peer, Right

VERSION = 1
_DEPTH, _DIGITS = 32, 30
_NAME = re.compile(r"[\w.@ -]{1,60}", re.ASCII)
"""In whose name somebody asks, who has let them in by other means: it is noted, and gives no right."""

Fields = TypeVar("Fields", bound=BaseModel)


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


@dataclass(frozen=True)
class Verb:
    """What a client can ask for: what is done, and the right that it takes."""

    act: Callable[[Request], Awaitable[Any]]
    right: Right
    stops: bool = False
    """It only ever brings the cell nearer to rest: it is answered also where there is no room for anything else."""


def parsed(line: bytes, peer: Peer) -> Request:
    """The request in `line`; UsageError where there is none."""
    try:
        document = json.loads(
            line, parse_constant=_no_number, parse_float=_finite, parse_int=_whole, object_pairs_hook=_once
        )
    except (ValueError, RecursionError) as problem:
        raise UsageError(f"not a line of JSON: {problem}") from problem
    if line.count(b"[") + line.count(b"{") > _DEPTH and is_deeper(document, _DEPTH):
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


def is_deeper(document: Any, depth: int) -> bool:
    """Whether sections and lists of it are nested more than so deep."""
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


def _whole(text: str) -> int:
    if len(text) > _DIGITS:
        raise ValueError(f"a number of {len(text)} digits")
    return int(text)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A section; of a key that is given twice nobody knows which is meant."""
    section = dict(pairs)
    if len(section) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise UsageError(f"the key {twice!r:.60} is given twice; leave one")
    return section


def success(result: Any) -> bytes:
    """The answer of a verb that did what was asked."""
    return _line({"version": VERSION, "ok": True, "result": result})


def failure(problem: MicromanipError) -> bytes:
    """The answer of one that did not."""
    return _line({"version": VERSION, "ok": False, "error": str(problem), "exit_code": problem.exit_code})


def _line(answer: dict[str, Any]) -> bytes:
    return json.dumps(answer).encode() + b"\n"
