"""Plots as plain data: numbers, not pictures. A report's script draws them, or :func:`~.canvas.drawn` does."""

from __future__ import annotations

from dataclasses import dataclass

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
