"""YAML text -> plain data, and the line on which every key and list entry stands.

Keys are always text. Anchors, aliases and merge keys (``<<``) work.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any

from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from .place import Path
from .yaml_text import SCALARS, TAG, TOO_DEEP, Problem, compose

_MAX_NODES = 100_000  # a few aliases of aliases can otherwise expand to more than memory holds
_MAX_DEPTH = 50
_MAX_INTEGER = 2**63


@dataclass
class Document:
    """A parsed text: the data, the line of every key in it, and what is wrong with the YAML itself."""

    data: Any = None
    lines: dict[Path, int] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)


def parse(text: str) -> Document:
    """Parse a text; never raises, what is wrong is in ``problems``."""
    document = Document()
    match compose(text):
        case Problem() as problem:
            document.problems.append(problem)
        case Node() as root:
            document.lines[()] = _line(root)
            document.data = _Builder(document).build(root, ())
    return document


def _line(node: Node) -> int:
    return int(node.start_mark.line) + 1


def _is_text(value: str) -> bool:
    return not any("\ud800" <= character <= "\udfff" for character in value)


_NO_TEXT = "an escape that is only half a character, such as \\ud800"


class _Builder:
    def __init__(self, document: Document) -> None:
        self._document = document
        self._ancestors: list[Node] = []
        self._count = 0
        self._is_full = False

    def build(self, node: Node, path: Path) -> Any:
        if not self._may_enter(node, path):
            return None
        self._ancestors.append(node)
        if isinstance(node, MappingNode):
            data: Any = self._mapping(node, path)
        elif isinstance(node, SequenceNode):
            data = self._sequence(node, path)
        else:
            data = self._scalar(node, path)
        self._ancestors.pop()
        return data

    def _may_enter(self, node: Node, path: Path) -> bool:
        """False, with a report, where aliases lead in a circle or to more than any configuration holds."""
        self._count += 1
        if self._count > _MAX_NODES:
            if not self._is_full:
                self._report(node, path, f"more than {_MAX_NODES} values; aliases are counted where they are used")
            self._is_full = True
        elif node in self._ancestors:
            self._report(node, path, "an alias of the section it stands in")
        elif len(self._ancestors) > _MAX_DEPTH:
            self._report(node, path[:3], TOO_DEEP)
        else:
            return True
        return False

    def _report(self, node: Node, path: Path, text: str) -> None:
        self._document.problems.append(Problem(_line(node), path, text))

    def _mapping(self, node: MappingNode, path: Path) -> dict[str, Any]:
        self._check_tag(node, path, "map")
        data = {}
        for key, (key_node, value) in self._entries(node, path).items():
            self._document.lines[(*path, key)] = _line(key_node)
            data[key] = self.build(value, (*path, key))
        return data

    def _entries(self, node: MappingNode, path: Path) -> dict[str, tuple[Node, Node]]:
        """Keys of a mapping; its own come before those it merges."""
        entries: dict[str, tuple[Node, Node]] = {}
        merged: list[Node] = []
        self._count += len(node.value)
        for key, value in node.value:
            if not isinstance(key, ScalarNode):
                self._report(key, path, "a key must be a plain name, not a list or section")
            elif not _is_text(key.value):
                self._report(key, path, _NO_TEXT)
            elif key.tag == f"{TAG}merge":
                merged += value.value if isinstance(value, SequenceNode) else [value]
            elif key.value in entries:
                first = _line(entries[key.value][0])
                self._report(key, (*path, key.value), f"duplicate key, it is already on line {first}; delete one")
            else:
                entries[key.value] = (key, value)
        for source in merged:
            if not isinstance(source, MappingNode):
                self._report(source, path, "<< merges sections only, e.g. <<: *name")
            elif self._may_enter(source, path):
                self._ancestors.append(source)
                entries = {**self._entries(source, path), **entries}
                self._ancestors.pop()
        return entries

    def _sequence(self, node: SequenceNode, path: Path) -> list[Any]:
        self._check_tag(node, path, "seq")
        data = []
        for index, value in enumerate(node.value):
            self._document.lines[(*path, index)] = _line(value)
            data.append(self.build(value, (*path, index)))
        return data

    def _scalar(self, node: Node, path: Path) -> str | int | float | bool | None:
        text: str = node.value
        name = node.tag.removeprefix(TAG)
        if not _is_text(text):
            self._report(node, path, _NO_TEXT)
            return None
        if name not in SCALARS:
            self._check_tag(node, path, "str")
            return text
        pattern, _, words = SCALARS[name]
        if not re.fullmatch(pattern, text):  # only where the file has a tag of its own, such as !!int
            self._report(node, path, f"the tag !!{name} needs {words}, not {text!a}")
            return None
        if name == "int":
            return self._integer(node, path)
        if name == "float":
            return self._float(node, path)
        return {"null": None, "bool": text.lower() == "true", "merge": text}[name]

    def _integer(self, node: Node, path: Path) -> int:
        text: str = node.value
        base = {"0x": 16, "0o": 8}.get(text[:2], 10)
        number = int(text, base) if len(text) < 1000 else _MAX_INTEGER  # Python refuses to convert very long ones
        if abs(number) >= _MAX_INTEGER:
            self._report(node, path, "this number is too large")
            return 0
        return number

    def _float(self, node: Node, path: Path) -> float:
        text: str = node.value
        number = math.nan if text[-3:].isalpha() else float(text)
        if not math.isfinite(number):
            self._report(
                node, path, f"expected a finite number, not {text[:20]}; where no limit is meant, null says so"
            )
            return 0.0
        return number

    def _check_tag(self, node: Node, path: Path, kind: str) -> None:
        if node.tag != TAG + kind:
            self._report(node, path, f"the tag {node.tag.replace(TAG, '!!')!a} isn't known here; leave it out")
