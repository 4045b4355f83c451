"""What a change of values takes: applied while tracking, only with the outputs at rest, or only by a new start.

The schema says it of each key (`micromanip.settings.schema.key`), and which way a value protects less: that way it
takes outputs at rest, the other way it may change at any time.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping
from typing import Any

from micromanip.settings.schema.faults import REACTIONS
from micromanip.settings.schema.key import LARGER, LIVE, NEITHER, RESTART, SMALLER, WIDER
from micromanip.settings.schema.model import PLAUSIBLE_UM, Configuration
from micromanip.settings.schema.reference import File
from micromanip.settings.text.place import Path
from micromanip.settings.text.shape import Shape

ABSENT = object()
"""Stands for a key that a configuration does not have."""
WEAKENS = "would weaken a protection and needs disarm"

Values = dict[Path, Any]


@functools.cache
def said(path: Path, word: str) -> str | None:
    """What the schema says of the key at `path`: of its `change`, or which value is `weaker`; None where nothing."""
    return Shape.of(Configuration).at(path).said(word)


def needed(path: Path) -> str:
    """What a change of the key at `path` takes; of one that the schema does not know: a new start."""
    return said(path, "change") or RESTART


def values(configuration: Configuration) -> Values:
    """Every key and its value, defaults too; a list is one value."""
    return {path: value for path, value in leaves(configuration.model_dump(mode="json")).items() if value != {}}


def leaves(document: Mapping[str, Any]) -> Values:
    """Every key of a document and its value; a list is one value, and so is a section without keys."""
    return dict(_leaves((), document))


def _leaves(path: Path, value: Any) -> Iterator[tuple[Path, Any]]:
    if not isinstance(value, Mapping) or (path and not value):
        yield path, value
    else:
        for key, entry in value.items():
            yield from _leaves((*path, key), entry)


def changed(old: Configuration, new: Configuration) -> dict[Path, tuple[Any, Any]]:
    """Keys whose values differ, each with both; `ABSENT` for one that is not there."""
    return differing(values(old), values(new))


def differing(before: Values, after: Values) -> dict[Path, tuple[Any, Any]]:
    """The same of keys and values."""
    pairs = {path: (before.get(path, ABSENT), after.get(path, ABSENT)) for path in {**before, **after}}
    return {path: pair for path, pair in pairs.items() if pair[0] != pair[1]}


def needs(old: Configuration, new: Configuration) -> dict[Path, str]:
    """What each changed key takes, the names and the order of drivers and axes considered."""
    found = {path: needed(path) for path in changed(old, new)}
    if File in (type(old.reference), type(new.reference)):
        found |= {path: RESTART for path in found if path[0] == "reference"}
    for section in ("drivers", "signals", "outputs", "axes"):
        before, after = list(getattr(old, section)), list(getattr(new, section))
        if set(before) != set(after):
            added_or_removed = set(before) ^ set(after)
            found |= {path: RESTART for path in found if path[0] == section and path[1] in added_or_removed}
        elif before != after and section in ("drivers", "axes"):  # their order is that of the loop's records
            found[section,] = RESTART
    return found


def demands(old: Configuration, new: Configuration) -> dict[Path, str]:
    """What is more than live of the changes from `old` to `new`, by key: DISARM, RESTART or WEAKENS."""
    weakened = {path: WEAKENS for path, pair in changed(old, new).items() if is_weaker(path, *pair)}
    return weakened | {path: what for path, what in needs(old, new).items() if what != LIVE}


def is_weaker(path: Path, old: Any, new: Any) -> bool:
    """Whether `new` protects less than `old` at `path`."""
    weaker = said(path, "weaker")
    if weaker in (None, NEITHER) or ABSENT in (old, new):
        return False
    if isinstance(old, str):
        return REACTIONS.index(new) < REACTIONS.index(old)
    if weaker in (LARGER, SMALLER):
        return _size(new) > _size(old) if weaker == LARGER else _size(new) < _size(old)
    inner, outer = (new, old) if weaker == WIDER else (old, new)
    (inner_low, inner_high), (outer_low, outer_high) = _bounds(inner), _bounds(outer)
    return inner_low < outer_low or inner_high > outer_high


def _size(value: float | None) -> float:
    return math.inf if value is None else value


def _bounds(pair: tuple[float, float] | None) -> tuple[float, float]:
    return PLAUSIBLE_UM if pair is None else pair
