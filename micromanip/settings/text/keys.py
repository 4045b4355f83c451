"""Keys as people type them, ``axes.x.inner.Ti_ms`` or ``axes.x.hysteresis.weights[3]``, and what they stand for."""

from __future__ import annotations

import copy
import difflib
import re
from collections.abc import Iterable, Mapping
from typing import Any

from micromanip.errors import UsageError

from . import yaml_nodes
from .place import Path
from .source import key_text

_PART = re.compile(r"(?P<name>[^.\[\]]+)(?P<indices>(\[[0-9]{1,4}\])*)")

_MAX_LENGTH = 300
_MAX_SHOWN = 10


def key_path(key: str) -> Path:
    """Path of a key; UsageError where it isn't written as one."""
    path: list[str | int] = []
    if len(key) > _MAX_LENGTH:
        raise UsageError(f"{key[:40]!r}... is not a key: keys are much shorter")
    for part in key.split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise UsageError(f"{key[:80]!r} is not a key; keys are written like axes.x.inner.Ti_ms")
        path += [match["name"], *map(int, re.findall(r"[0-9]+", match["indices"]))]
    return tuple(path)


def assigned(document: Mapping[str, Any], known: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """`document` with `values` (key -> value); `known` is the same with every default spelt out.

    Sections that nothing is assigned in are those of `document`, which stays as it is.

    A key whose section is known may be new: validation says what that section takes. Raises UsageError, a line a
    key, where there is no such section, naming the nearest key.
    """
    revised: dict[str, Any] = dict(document)
    unknown: list[Path] = []
    for key, value in values.items():
        path = key_path(key)
        if _may_take(_at(known, path[:-1]), path[-1]):
            _assign(revised, known, path, value)
        else:
            unknown.append(path)
    if unknown:
        raise _unknown(known, unknown)
    return revised


def _assign(document: dict[str, Any], known: Mapping[str, Any], path: Path, value: Any) -> None:
    place: Any = document
    for end, part in enumerate(path[:-1], start=1):
        if isinstance(part, str) and isinstance(place, dict) and place.get(part) is None:
            default = _at(known, path[:end])
            place[part] = {} if isinstance(default, Mapping) else copy.deepcopy(default)
        if _may_take(place, part):
            place[part] = copy.copy(place[part])
            place = place[part]
        else:
            place = None
    if not _may_take(place, path[-1]):
        raise UsageError(f"{key_text(path)}: another key of the same set replaces the section that it stands in")
    place[path[-1]] = value


def selected(leaves: Iterable[Path], document: Mapping[str, Any], keys: Iterable[str]) -> list[Path]:
    """Those of `leaves` that `keys` name, alone or by their section; all without keys. UsageError as `assigned`."""
    leaves, paths = list(leaves), [key_path(key) for key in keys]
    if unknown := [path for path in paths if not any(leaf[: len(path)] == path for leaf in leaves)]:
        raise _unknown(document, unknown)
    return [leaf for leaf in leaves if not paths or any(leaf[: len(path)] == path for path in paths)]


def assignments_of(texts: Iterable[str]) -> dict[str, Any]:
    """Key -> value of ``KEY=VALUE`` texts, values as in the file; UsageError where one isn't, or comes twice."""
    values: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals:
            raise UsageError(f"{text!r:.80} is no KEY=VALUE, such as axes.x.inner.Ti_ms=0.6")
        if key in values:
            raise UsageError(f"{key} is given twice")
        values[key] = yaml_value(key, value)
    return values


def yaml_value(key: str, text: str) -> Any:
    """What `text` means as a value in the file; raises UsageError where it isn't YAML."""
    document = yaml_nodes.parse(text)
    if document.problems:
        raise UsageError(f"{key}: {document.problems[0].text}")
    return document.data


def _at(document: Any, path: Path) -> Any:
    for part in path:
        if not _may_take(document, part) or (isinstance(document, Mapping) and part not in document):
            return None
        document = document[part]
    return document


def _may_take(section: Any, part: str | int) -> bool:
    if isinstance(part, str):
        return isinstance(section, Mapping)
    return isinstance(section, list) and part < len(section)


def _unknown(document: Mapping[str, Any], paths: list[Path]) -> UsageError:
    known = list(_keys(document))
    lines = [_unknown_key(document, known, path) for path in paths[:_MAX_SHOWN]]
    if more := len(paths) - len(lines):
        lines.append(f"and {more} more unknown keys")
    return UsageError("\n".join(lines))


def _unknown_key(document: Mapping[str, Any], known: list[str], path: Path) -> str:
    key = key_text(path)
    for end in range(len(path) - 1, 0, -1):
        if _at(document, path[:end]) is None and key_text(path[:end]) in known:
            section = key_text(path[:end])
            return f"{key}: {section} is null; give the whole section, {section}={{...}}"
    near = _nearest(key, known)
    return f"unknown key {key}" + (f"; did you mean {near}?" if near else "; `get` lists all keys")


def _nearest(key: str, known: list[str]) -> str | None:
    """A key that ends alike, or one that is written alike."""
    ends = [name for name in known if name.endswith(f".{key}")]
    return next(iter(ends or difflib.get_close_matches(key, known, 1)), None)


def _keys(section: Any, path: Path = ()) -> Iterable[str]:
    entries = section.items() if isinstance(section, Mapping) else ()
    for name, value in entries:
        yield key_text((*path, name))
        yield from _keys(value, (*path, name))
