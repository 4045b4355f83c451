"""What pydantic finds, in plain words: at which key, what is wrong, and what would be right, with hints."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sized

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from micromanip.errors import nearest

from . import units
from .place import Finding, Path, Place, locate
from .shape import Shape
from .source import key_text

_IN_THOUSANDS = re.compile(r",(?=\d{3}(?!\d))")
_NUMBER = re.compile(r"(?P<number>[-+]?([0-9][0-9_]*([.,][0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?)\s*(?P<unit>.*)")
_NO_VALUE = ("none", "nil", "off", "no")
_YES_NO = {"yes": "true", "on": "true", "y": "true", "no": "false", "off": "false", "n": "false"}


def unknown_key(place: Place) -> tuple[str, Path | None]:
    """What to say of a key that its section doesn't know, and the path it was probably meant to have."""
    key, section = str(place.path[-1]), place.parent
    unknown = f"unknown key {key_text((key,))}"
    if section is None:
        return unknown, None
    fields = section.shape.fields
    stem, _ = units.split(key)
    same_stem = [known for known in fields if stem and units.split(known)[0] == stem]
    elsewhere = None if same_stem else _section_that_knows(section, key)
    if elsewhere:
        where = key_text(elsewhere.path) or "the top level"
        return f"{unknown} here: it belongs to {where}{_variant_of(elsewhere, key)}", (*elsewhere.path, key)
    if near := same_stem[0] if same_stem else nearest(key, list(fields)):
        meant = section.down(near)
        return f"{unknown}: did you mean {near}{unit(meant)}?", meant.path
    return f"{unknown}: known here are {', '.join(fields) or 'none'}", None


def _section_that_knows(section: Place, key: str) -> Place | None:
    """Wrong indentation, or a key of another kind of hysteresis or reference: look at the sections close by."""
    near = [section]
    if section.parent:
        near += [section.parent, *_alternatives(section.parent)]
    below = [part for place in near for name in place.shape.fields for part in _sections(place.down(name))]
    return next((place for place in near + below if key in place.shape.fields), None)


def _sections(place: Place) -> list[Place]:
    if place.shape.type == "array":
        place = place.down(0)
    return _alternatives(place) or [place]


def _alternatives(place: Place) -> list[Place]:
    return [Place(place.path, variant, place) for variant in place.shape.variants]


def _variant_of(place: Place, key: str) -> str:
    """`` with model: pi`` for a key that only this alternative of a union has."""
    tag = place.parent.shape.discriminator if place.parent else None
    return f" with {tag}: {place.shape.fields[tag].words()}" if tag and tag != key else ""


def unit(place: Place) -> str:
    """The unit of a key in words, `` (milliseconds)``; empty if it has none."""
    words = units.words_for(_key(place))
    return f" ({words})" if words else ""


def correction(place: Place, value: object) -> str:
    """The value that was probably meant; empty without an idea."""
    shape = place.shape
    if shape.choices and isinstance(value, str | None):
        near = nearest(str(value), [str(choice) for choice in shape.choices])
        return f"did you mean {near}?" if near else ""
    if isinstance(value, str) and (meant := _from_text(place, value.strip())):
        return meant
    if shape.type == "string" and isinstance(value, int | float):
        return _write(place, '"' + str(value).lower() + '"')
    if shape.type == "integer" and isinstance(value, float) and value.is_integer() and shape.allows(value):
        return _write(place, str(int(value)))
    if place.path and place.path[-1] in shape.fields:
        return f"{place.path[-1]} is a key of such a section, indent it further"
    return ""


def _from_text(place: Place, text: str) -> str:
    shape = place.shape
    if shape.nullable and text.lower() in _NO_VALUE:
        return _write(place, "null")
    if shape.type == "boolean" and (meant := _YES_NO.get(text.lower(), text.lower())) in ("true", "false"):
        return _write(place, meant)
    if shape.type == "array":
        entries = [_NUMBER.fullmatch(entry) for entry in re.split(r"[,\s]+", text.strip("()"))]
        plain = [entry["number"] for entry in entries if entry and not entry["unit"]]
        return _write(place, f"[{', '.join(plain)}]") if len(plain) == len(entries) else ""
    if shape.type in ("number", "integer") and (match := _NUMBER.fullmatch(text)):
        number = match["number"].replace("_", "")
        if shape.type == "integer":
            number = _IN_THOUSANDS.sub("", number)
        return _from_quantity(place, number.replace(",", "."), match["unit"])
    return ""


def _from_quantity(place: Place, number: str, given: str) -> str:
    correct = _write(place, number)
    wanted = units.words_for(_key(place))
    if not given:
        return correct
    if wanted is None:
        return f"the number goes without a unit, {correct}"
    plain = given.replace("µ", "u").replace("μ", "u").replace("/", "_per_").replace("%", "percent")
    if (units.words(plain) or plain) == wanted:
        return f"the key names the unit, {correct}"
    return f"the key names the unit, write the number in {wanted}"


def _key(place: Place) -> str:
    """The name of a value; an entry of a list goes by the list's."""
    return next((part for part in reversed(place.path) if isinstance(part, str)), "")


def _write(place: Place, value: str) -> str:
    key = place.path[-1] if place.path else 0
    return f"write {value}" if isinstance(key, int) else f"write {key}: {value}"


def shown(value: object) -> str:
    """A value from the file in words."""
    match value:
        case None:
            return "an empty value"
        case bool():
            return str(value).lower()
        case str():
            return f"the text {value!a}" if len(value) <= 40 else f"the text {value[:40]!a}..."
        case int() | float():
            return str(value)
        case list():
            return f"a list of {len(value)}" if value else "an empty list"
        case dict():
            return "a section" if value else "an empty section"
    return str(type(value).__name__)


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
        text, meant = unknown_key(place)
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
    return place.path, f"{detail['msg'].removeprefix('Input ')}, not {shown(value)}"


def _unexpected(place: Place, value: object) -> Finding:
    hint = correction(place, value)
    return place.path, f"expected {place.shape.expected()}, not {shown(value)}{': ' if hint else ''}{hint}"


def _missing(place: Place, value: object) -> Finding:
    if isinstance(place.path[-1], int) and place.parent:  # a pair with only one entry
        return _unexpected(place.parent, value)
    text = f"missing, it takes {place.shape.expected()}{unit(place)}"
    return place.path, f"{text}: {place.shape.description}".removesuffix(": ").removesuffix(".")


def _broken_rule(message: str, place: Place) -> Finding:
    """A rule of the section; where its message begins with a key of the section, the finding is at that key."""
    message = " ".join(message.split())
    match = _RULE.fullmatch(message)
    if match is None or match["key"] not in place.shape.fields:
        return place.path, message
    path = (*place.path, match["key"], *match["below"].split(".")[1:])
    return path, match["rest"] if match["colon"] else message
