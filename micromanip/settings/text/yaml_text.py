"""YAML text -> nodes, each with its line and type; or one clear sentence on why it isn't YAML.

Types follow YAML 1.2, as people read them: ``1e-3`` is a number, ``on``, ``yes`` and ``12:30`` are text, ``012`` is
twelve.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import yaml
from yaml.nodes import Node

from .place import Path

TAG = "tag:yaml.org,2002:"
TOO_DEEP = "nested too deeply"


@dataclass(frozen=True)
class Problem:
    """What is wrong on a line, and the key path if there is one."""

    line: int
    path: Path
    text: str


class _Loader(yaml.BaseLoader):
    """YAML 1.2 core schema; PyYAML's own loaders follow YAML 1.1."""


# Name of the type -> what it looks like, the characters it can begin with, and how a message names it.
SCALARS = {
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
for _name, (_pattern, _first, _) in SCALARS.items():
    _Loader.add_implicit_resolver(TAG + _name, re.compile(rf"(?:{_pattern})\Z"), list(_first))


def compose(text: str) -> Node | Problem | None:
    """The root node, None for an empty text, or what is wrong with it."""
    try:
        return yaml.compose(text, Loader=_Loader)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        return Problem(line, (), f"character {chr(error.character)!a} can't stand in YAML")
    except yaml.MarkedYAMLError as error:
        return _syntax_problem(error)
    except RecursionError:
        return Problem(1, (), TOO_DEEP)
    except (ValueError, OverflowError):
        # PyYAML converts \U escapes and the %YAML version without checking their range.
        return Problem(1, (), "not YAML: an escape sequence or a %YAML line with an impossible number")


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
