"""Writing changed values into a configuration file: only their keys change, comments and order stay."""

from __future__ import annotations

import copy
import functools
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from ruamel.yaml.comments import CommentedMap, CommentedSeq

from micromanip.errors import ConfigError, system_error
from micromanip.settings.text.place import Path
from micromanip.settings.text.source import Source

from .change import ABSENT, differing, leaves
from .write import edited, node, write_atomically

_PASSES = 3
"""A section that merged (``<<``) a changed one gets what it had back in the next pass."""


def write_into(file: Source, document: Mapping[str, Any]) -> Source:
    """`file` after `document` was written into it; errors of `with_values`, or of the system where it can't be."""
    text = with_values(file, document)
    try:
        write_atomically(file.path, text)
    except OSError as problem:
        raise system_error(problem, f"{file.path} can't be written") from problem
    return Source.parse(file.path, text)


def with_values(source: Source, document: Mapping[str, Any]) -> str:
    """Text of the file `source` edited to hold `document`.

    Raises ConfigError where the file, as it is written, can't be edited to mean exactly that.
    """
    text, data = source.text, source.data
    for _ in range(_PASSES):
        if data == document:
            return text
        changes = differing(leaves(data), leaves(document))
        text = edited(text, functools.partial(_apply, changes))
        data = Source.parse(source.path, text).data
    if data == document:
        return text
    raise ConfigError(f"{source.path}: its anchors or merge keys can't be kept with these values; edit it by hand")


def _apply(changes: Mapping[Path, tuple[Any, Any]], document: Any) -> None:
    for path, (_, new) in changes.items():
        if new is ABSENT:
            _remove(document, path)
    for path, (_, new) in changes.items():
        if new is not ABSENT:
            _put(document, path, new)


def _remove(document: Any, path: Path) -> None:
    section = _descend(document, path[:-1], create=False)
    if section is not None:
        section.pop(path[-1], None)


def _put(document: Any, path: Path, value: Any) -> None:
    _descend(document, path[:-1], create=True)[path[-1]] = node(value)


def _descend(document: Any, path: Path, *, create: bool) -> Any:
    """The section at `path`, one that no other place of the document shares; None where it is not there."""
    section = document
    for part in path:
        child = section.get(part)
        if not isinstance(child, CommentedMap):
            if not create:
                return None
            section[part] = CommentedMap()
        elif _occurrences(document)[id(child)] > 1:  # written once, meant for several places (*alias)
            section[part] = copy.deepcopy(child)
            section[part].yaml_set_anchor(None)
        section = section[part]
    return section


def _occurrences(document: Any) -> Counter[int]:
    """How many places of the document each section stands in."""
    return Counter(id(node) for node in _sections(document))


def _sections(node: Any) -> Iterable[Any]:
    if isinstance(node, CommentedMap):
        yield node
        for child in node.values():
            yield from _sections(child)
    elif isinstance(node, CommentedSeq):
        for child in node:
            yield from _sections(child)
