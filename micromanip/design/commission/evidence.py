"""What commissioning an axis leaves behind for people: verdicts, figures and plots, as plain data.

The plots hold numbers, not pictures: the report draws them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..criterion import Criterion

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
    """Rows of text below their heads; the first of each row names it."""

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Section:
    """A step of the commissioning: what was done in words, figures by name, tables, its plots."""

    title: str
    text: str
    figures: dict[str, str] = field(default_factory=dict)
    plots: tuple[Plot, ...] = ()
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True)
class Evidence:
    """Everything about one axis."""

    axis: str
    criteria: tuple[Criterion, ...]
    sections: tuple[Section, ...]

    @property
    def passed(self) -> bool:
        """Whether no criterion fails."""
        return all(criterion.passed for criterion in self.criteria)

    @property
    def proven(self) -> bool:
        """Whether none fails but for accuracy: such an axis may run."""
        return all(criterion.passed or criterion.acceptance for criterion in self.criteria)
