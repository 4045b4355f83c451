"""Which changes weaken a protection: they take outputs at rest; the other way the same keys may change at any time."""

from __future__ import annotations

import math
from typing import Any

from micromanip.settings.compile.cell import PLAUSIBLE_UM
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.place import Path

from .change import ABSENT, changed, fits

WEAKENS = "would weaken a protection and needs disarm"

LARGER, SMALLER, WIDER, NARROWER, NEITHER = "larger", "smaller", "wider", "narrower", "neither"

WEAKER: tuple[tuple[str, str], ...] = (
    ("signals.*.max_age_us", LARGER),
    ("signals.*.range_um", WIDER),
    ("faults.axis.disagreement.process_ms", SMALLER),  # a force that comes faster excuses more
    ("faults.axis.oscillation.band_Hz", NARROWER),
    ("faults.axis.reference.decay_ms", NEITHER),  # how the way back is taken, not whether
    ("faults.**", LARGER),
    ("axes.*.faults.disagreement.process_ms", SMALLER),
    ("axes.*.faults.oscillation.band_Hz", NARROWER),
    ("axes.*.faults.reference.decay_ms", NEITHER),
    ("axes.*.faults.**", LARGER),
)
"""The direction in which a value protects less; the first rule that fits counts. Null is no limit at all.

A reaction has no size: it is weaker where it is milder.
"""

_HARDEST_FIRST = ("off", "ramp", "hold", "warn")
_SPLIT = tuple((tuple(pattern.split(".")), direction) for pattern, direction in WEAKER)


def weakened(old: Configuration, new: Configuration) -> dict[Path, str]:
    """`WEAKENS` by each key that protects less in `new`."""
    return {path: WEAKENS for path, pair in changed(old, new).items() if is_weaker(path, *pair)}


def direction(path: Path) -> str | None:
    """In which the value at `path` protects less; None where it is no protection."""
    return next((direction for pattern, direction in _SPLIT if fits(pattern, path)), None)


def is_weaker(path: Path, old: Any, new: Any) -> bool:
    """Whether `new` protects less than `old` at `path`."""
    weaker = direction(path)
    if weaker in (None, NEITHER) or ABSENT in (old, new):
        return False
    if isinstance(old, str):
        return _HARDEST_FIRST.index(new) > _HARDEST_FIRST.index(old)
    if weaker in (LARGER, SMALLER):
        return _size(new) > _size(old) if weaker == LARGER else _size(new) < _size(old)
    inner, outer = (new, old) if weaker == WIDER else (old, new)
    (inner_low, inner_high), (outer_low, outer_high) = _bounds(inner), _bounds(outer)
    return inner_low < outer_low or inner_high > outer_high


def _size(value: float | None) -> float:
    return math.inf if value is None else value


def _bounds(pair: tuple[float, float] | None) -> tuple[float, float]:
    return PLAUSIBLE_UM if pair is None else pair
