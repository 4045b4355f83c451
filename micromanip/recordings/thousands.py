"""Whole numbers with a mark between thousands that was read as a decimal mark: 998, 999, 1.000, 1.001."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from .table import Array

_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
_SURE = 20
"""Numbers of that form from which on fractions are no longer likely: of those one in ten ends in a zero, left out."""


def marked_thousand(values: Array, fields: Callable[[], Sequence[str]], mark: str) -> int | None:
    """The first of `values` (n,) whose `mark` is one between thousands, by the `fields` (n,) it was read from.

    None where they are fractions, or may be: whole numbers stand beside others, and each mark is before three digits.
    """
    size = np.abs(values[np.isfinite(values)])
    whole = size == np.rint(size)
    if whole.all() or not whole.any() or np.any((size > 0) & (size < 1)) or np.any(size >= 1000):
        return None
    if np.any(np.abs(1e3 * size - np.rint(1e3 * size)) > 1e-6):
        return None
    found = fields()
    marked = [k for k, field in enumerate(found) if mark in field]
    if not _SURE <= len(marked) < len(found) or not all(_GROUPED.fullmatch(found[k]) for k in marked):
        return None
    return marked[0]
