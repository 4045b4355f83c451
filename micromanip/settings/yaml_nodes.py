"""YAML text -> plain data, and the line on which every key and list entry stands.

Scalars follow YAML 1.2, as people read them: ``1e-3`` is a number, ``on``, ``yes`` and ``12:30`` are text, ``012`` is
twelve. Keys are always text. Anchors, aliases and merge keys (``<<``) work.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from .shape import Path

_TAG = "tag:yaml.org,2002:"
_MAX_NODES = 100_000  # a few aliases of aliases can otherwise expand to more than memory holds
_MAX_INTEGER = 2**63


class _Loader(yaml.BaseLoader):
    """YAML 1.2 core schema; PyYAML's own loaders follow YAML 1.1."""


# Name of the type -> what it looks like, the characters it can begin with, and how a message names it.
_SCALARS = {
    "null": (r"~|null|Null|NULL|", ("~", "n", "N", ""), "null"),
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF", "true or false"),
    "int": (r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", "-+0123456789", "a whole number"),
    "float": (
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        "-+.0123456789",
        "a number",
    ),
    "merge": (r"<<", "<", "<<"),
}
for _name, (_pattern, _first, _) in _SCALARS.items():
    _Loader.add_implicit_resolver(_TAG + _name, re.compile(rf"(?:{_pattern})\Z"), list(_first))


@dataclass(frozen=True)
class Problem:
    """What is wrong on a line, and the key path if there is one."""

    line: int
    path: Path
    text: str


@dataclass
class Document:
    """A parsed text: the data, the line of every path in it, and what is wrong with the YAML itself."""

    data: Any = None
    lines: dict[Path, int] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)


def parse(text: str) -> Document:
    """Parse a text; never raises, what is wrong is in ``problems``."""
    document = Document()
    try:
        root = yaml.compose(text, Loader=_Loader)
        if root is not None:
            document.lines[()] = _line(root)
            document.data = _Builder(document).build(root, ())
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        document.problems = [Problem(line, (), f"character {chr(error.character)!a} can't stand in YAML")]
    except yaml.MarkedYAMLError as error:
        document.problems = [_syntax_problem(error)]
    except RecursionError:
        document.problems = [Problem(1, (), "nested too deeply")]
    except (ValueError, OverflowError):
        # PyYAML converts \U escapes and the %YAML version without checking their range.
        document.problems = [Problem(1, (), "not YAML: an escape sequence or a %YAML line with an impossible number")]
    return document


# PyYAML's words -> ours, and whether the place to look at is where the construct began.
_SYNTAX = (
    ("cannot start any token", "character {character} can't start a value; indent with spaces, quote the text", False),
    ("mapping values are not allowed", "unexpected colon; check the indentation here and on the line before", False),
    ("could not find expected ':'", "no colon after this key", True),
    ("unexpected end of stream", "this quote isn't closed", True),
    ("expected ',' or ']'", "this [ isn't closed", True),
    ("expected ',' or '}'", "this {{ isn't closed", True),
    ("expected <block end>", "the indentation doesn't fit the lines before", False),
    ("but found another document", "a second document begins here; a configuration is a single one", False),
)


def _syntax_problem(error: yaml.MarkedYAMLError) -> Problem:
    said = " ".join(f"{error.context or ''} {error.problem or ''}".split())
    for fragment, words, at_beginning in _SYNTAX:
        if fragment in said:
            mark = error.context_mark if at_beginning else error.problem_mark
            character = re.search(r"found character (.*) that", said)
            said = words.format(character=character[1] if character else "")
            break
    else:
        mark = error.problem_mark or error.context_mark
    return Problem(mark.line + 1 if mark else 1, (), f"not YAML: {said}")


def _line(node: Node) -> int:
    return int(node.start_mark.line) + 1


class _Builder:
    def __init__(self, document: Document) -> None:
        self._document = document
        self._ancestors: list[Node] = []
        self._count = 0

    def build(self, node: Node, path: Path) -> Any:
        self._count += 1
        if self._count > _MAX_NODES or node in self._ancestors:
            if self._count <= _MAX_NODES:
                self._report(node, path, "an alias of the section it stands in")
            elif self._count == _MAX_NODES + 1:
                self._report(node, path, f"more than {_MAX_NODES} values; aliases are counted where they are used")
            return None
        self._ancestors.append(node)
        try:
            if isinstance(node, MappingNode):
                return self._mapping(node, path)
            if isinstance(node, SequenceNode):
                return self._sequence(node, path)
            return self._scalar(node, path)
        finally:
            self._ancestors.pop()

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
        for key, value in node.value:
            self._count += 1
            if not isinstance(key, ScalarNode):
                self._report(key, path, "a key must be a plain name, not a list or section")
            elif key.tag == f"{_TAG}merge":
                merged += value.value if isinstance(value, SequenceNode) else [value]
            elif key.value in entries:
                first = _line(entries[key.value][0])
                self._report(key, (*path, key.value), f"duplicate key, it is already on line {first}; delete one")
            else:
                entries[key.value] = (key, value)
        for source in merged:
            if not isinstance(source, MappingNode):
                self._report(source, path, "<< merges sections only, e.g. <<: *name")
            elif self._count <= _MAX_NODES:
                entries = {**self._entries(source, path), **entries}
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
        name = node.tag.removeprefix(_TAG)
        if name not in _SCALARS:
            self._check_tag(node, path, "str")
            return text
        pattern, _, words = _SCALARS[name]
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
        if node.tag != _TAG + kind:
            self._report(node, path, f"the tag {node.tag.replace(_TAG, '!!')!a} isn't known here; leave it out")
