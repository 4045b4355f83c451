"""The columns of the telemetry, as a scope offers them: a name, a unit, and how it is taken out of the ring's rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.telemetry import ROW

_UNITS = {"um": "um", "V": "V", "ns": "ns"}
_ABSCISSA = ("cycle", "time_ns")
_BITS = 31


@dataclass(frozen=True)
class Field:
    """One column; `axis` is the axis' number, None of what the whole cell has."""

    name: str
    """As `lateness_ns` or `x.strain_um`."""
    column: str
    axis: int | None
    unit: str
    """um, V or ns; empty for a count or a number."""

    @property
    def path(self) -> str:
        """Where a recording has it."""
        return self.column if self.axis is None else f"axis.{self.axis}.{self.column}"

    def of(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Its values (n) in these rows, as they are shown."""
        return self.shown(rows[self.column] if self.axis is None else rows["axis"][self.column][:, self.axis])

    def shown(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values as they are, but of the bits `conditions` the highest, which is a code of ``states``."""
        return highest_bit(values) if self.column == "conditions" else values


def fields(axes: Sequence[str], row: np.dtype[Any] = ROW) -> list[Field]:
    """Every column of a cell with these axes, those of the cell first; `row` is its telemetry."""
    of_cell = [Field(name, name, None, _unit(name)) for name in _names(row) if name not in (*_ABSCISSA, "axis")]
    names = _names(row["axis"].base)
    of_axes = [Field(f"{axis}.{name}", name, i, _unit(name)) for i, axis in enumerate(axes) for name in names]
    return of_cell + of_axes


def highest_bit(values: NDArray[Any]) -> NDArray[np.int64]:
    """Number of the highest bit of each value (n); 0 where none is set, and bit 0 means nothing to `states`."""
    found = np.zeros(len(values), np.int64)
    if values.any():
        for bit in range(1, _BITS):
            found[(values >> bit) & 1 == 1] = bit
    return found


def _names(dtype: np.dtype[Any]) -> tuple[str, ...]:
    assert dtype.names is not None
    return dtype.names


def _unit(name: str) -> str:
    return _UNITS.get(name.rpartition("_")[2], "")
