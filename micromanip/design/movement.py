"""How columns move: those that stand still are refused, nothing can be learned from them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

_CLEARLY = 0.5
"""Correlation."""


def stands_still(values: NDArray[np.float64]) -> bool:
    """Whether `values` (n,) are one value, to rounding."""
    return bool(np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())))


def moves_against(values: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether `values` (n,) fall while `other` (n,), which moves, rises."""
    return not stands_still(values) and float(np.corrcoef(values, other)[0, 1]) < -_CLEARLY


def require_movement(file: Path, columns: Mapping[str, NDArray[np.float64]]) -> None:
    """Refuse columns that stand still."""
    for name, values in columns.items():
        if stands_still(values):
            raise CheckFailed(
                f"{file}: {name} is constant: record while the actuator moves over the stroke that it will use"
            )
