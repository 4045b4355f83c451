"""Sections of a report with tables and plots, as plain data.

Plots are numbers, not pictures: a report's script draws them, or :func:`micromanip.design.plots.canvas.drawn` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """One curve: `x` (n,), `y` (n,); `marks` draws points instead of a line, with a text each where there are `texts`.

    `faint` is what should not be relied on.
    """

    label: str
    x: Array
    y: Array
    marks: bool = False
    faint: bool = False
    texts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plot:
    """One pair of axes with its curves; `note` says in a sentence what to look for."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    note: str = ""
    log_x: bool = False
    log_y: bool = False
    equal: bool = False
    """One unit is as long in both directions (Nyquist)."""


@dataclass(frozen=True)
class Table:
    """Rows of text below their heads; the first of each row names it. One that is `folded` opens at a click."""

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    folded: bool = False


@dataclass(frozen=True)
class Section:
    """What was done in words, figures by name, tables, its plots; a `listing` opens at a click."""

    title: str
    text: str
    figures: dict[str, str] = field(default_factory=dict)
    plots: tuple[Plot, ...] = ()
    tables: tuple[Table, ...] = ()
    listing: str = ""
