"""What pydantic finds, in plain words: at which key, what is wrong, and what would be right."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sized

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from . import hints
from .place import Finding, Path, Place, locate
from .shape import Shape

# Errors that say "not the right type, value or size"; the shape of the place has better words for what is expected.
_UNEXPECTED = re.compile(
    r"\w+_(type|parsing|error)|int_from_float|enum|greater_than(_equal)?|less_than(_equal)?|too_(short|long)|string_too_\w+"
)
_RULE = re.compile(r"(?P<key>[A-Za-z]\w*)(?P<below>(\.\w+)*)(?P<colon>:?) (?P<rest>.+)")


def findings(error: ValidationError, model: type[BaseModel], prefix: Path) -> list[Finding]:
    """One finding a mistake, at key paths that begin with ``prefix``."""
    root = Place(prefix, Shape.of(model))
    found: dict[Finding, None] = {}  # in order, and each once
    misspelt: set[Path | None] = set()
    unions: set[Path] = set()
    placed = [(detail, locate(root, detail["loc"])) for detail in error.errors(include_url=False)]
    for _, place in filter(_is_unknown_key, placed):
        text, meant = hints.unknown_key(place)
        found[place.path, text] = None
        misspelt.add(meant)
    for detail, place in itertools.filterfalse(_is_unknown_key, placed):
        path, text = _finding(detail, place)
        # A misspelt key is missing under its right name, and a bad entry makes its list too short.
        if text and not (detail["type"] == "missing" and path in misspelt):
            found[path, text] = None
            unions |= {path} if place.shape.variants else set()
    # Where a section was meant and has mistakes, it needs no saying that a plain value would do, too.
    return [(path, text) for path, text in found if not (path in unions and _has_finding_below(path, found))]


def _is_unknown_key(placed: tuple[ErrorDetails, Place]) -> bool:
    return placed[0]["type"] == "extra_forbidden"


def _has_finding_below(path: Path, found: Iterable[Finding]) -> bool:
    return any(len(below) > len(path) and below[: len(path)] == path for below, _ in found)


def _finding(detail: ErrorDetails, place: Place) -> Finding:
    kind, value = detail["type"], detail["input"]
    if kind == "missing":
        return _missing(place, value)
    if kind == "union_tag_not_found":
        return (*place.path, str(place.shape.discriminator)), f"missing, it takes {place.shape.tags.expected()}"
    if kind == "union_tag_invalid":
        key = str(place.shape.discriminator)
        return _unexpected(Place((*place.path, key), place.shape.tags, place), value[key])
    if kind in ("value_error", "assertion_error"):
        return _broken_rule(str(detail["ctx"]["error"]), place)
    if kind == "too_short" and isinstance(value, Sized) and len(value) >= detail["ctx"]["min_length"]:
        return place.path, ""  # it is long enough in the file; the bad entries have findings of their own
    if _UNEXPECTED.fullmatch(kind):
        return _unexpected(place, value)
    return place.path, f"{detail['msg'].removeprefix('Input ')}, not {hints.shown(value)}"


def _unexpected(place: Place, value: object) -> Finding:
    hint = hints.correction(place, value)
    return place.path, f"expected {place.shape.expected()}, not {hints.shown(value)}{': ' if hint else ''}{hint}"


def _missing(place: Place, value: object) -> Finding:
    if isinstance(place.path[-1], int) and place.parent:  # a pair with only one entry
        return _unexpected(place.parent, value)
    text = f"missing, it takes {place.shape.expected()}{hints.unit(place)}"
    return place.path, f"{text}: {place.shape.description}".removesuffix(": ").removesuffix(".")


def _broken_rule(message: str, place: Place) -> Finding:
    """A rule of the section; where its message begins with a key of the section, the finding is at that key."""
    message = " ".join(message.split())
    match = _RULE.fullmatch(message)
    if match is None or match["key"] not in place.shape.fields:
        return place.path, message
    path = (*place.path, match["key"], *match["below"].split(".")[1:])
    return path, match["rest"] if match["colon"] else message
