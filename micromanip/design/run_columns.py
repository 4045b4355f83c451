"""What reports read of a recording: its columns, of a run that is not too long all of them in one pass."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.recordings import Telemetry
from micromanip.rt.states import TRACKING

from .run_confidence import Array

_CELL = ("cycle", "periods", "state", "fault", "lateness_ns", "compute_ns")
_AXIS = ("path_error_um", "voltage_V", "strain_um", "setpoint_um")
_MOST_ROWS = 6_000_000
"""That are held at once: 10 min at 10 kHz, 0.8 GB of three axes. Longer runs are read column by column, each time."""


class RecordedRun:
    """A recording; `column` and `of_axis` give columns (n,) of all of its rows."""

    def __init__(self, telemetry: Telemetry) -> None:
        self.telemetry = telemetry
        self.axes = list(telemetry.axes)
        self.period_s = telemetry.period_ns * 1e-9

    def column(self, path: str) -> NDArray[Any]:
        """A column of the cell's, or ``axis.0.strain_um``. CheckFailed where the file is damaged, or far too long."""
        return self._held[path] if path in self._held else self.telemetry.column(path)

    def of_axis(self, axis: str, field: str) -> Array:
        """A column of an axis."""
        return np.asarray(self.column(f"axis.{self.axes.index(axis)}.{field}"))

    @cached_property
    def t_s(self) -> Array:
        """Time from the first row, by the counter of cycles."""
        cycles = self.column("cycle")
        return np.asarray((cycles - cycles[:1]) * self.period_s)

    @cached_property
    def tracks(self) -> NDArray[np.bool_]:
        """Whether it tracks."""
        return np.asarray(self.column("state") == TRACKING)

    def error_um(self, axis: str) -> Array:
        """Path error while it tracks, where it is known."""
        error = self.of_axis(axis, "path_error_um")[self.tracks]
        return error[np.isfinite(error)]

    def voltage_range(self, axis: str) -> tuple[float, float] | None:
        """Between what voltages (V) the limiter keeps an axis; of several sets of parameters the narrowest."""
        place = self.axes.index(axis)
        limits = [each["axis"][0, place]["limiter"] for each in self.telemetry.parameters]
        if not limits:
            return None
        return max(float(one["low_V"]) for one in limits), min(float(one["high_V"]) for one in limits)

    def voltage_left(self, axis: str) -> Array:
        """To the nearer end of that range (V), (n,); empty where it is not known."""
        limits, voltage = self.voltage_range(axis), self.of_axis(axis, "voltage_V")
        return np.empty(0) if limits is None else np.minimum(voltage - limits[0], limits[1] - voltage)

    @cached_property
    def _held(self) -> dict[str, NDArray[Any]]:
        paths = [*_CELL, *(f"axis.{place}.{field}" for place in range(len(self.axes)) for field in _AXIS)]
        parts: dict[str, list[NDArray[Any]]] = {path: [] for path in paths}
        rows = 0
        for part in self.telemetry.parts(paths):
            rows += len(part["cycle"])
            if rows > _MOST_ROWS:
                return {}
            for path in paths:
                parts[path].append(part[path])
        return {path: np.concatenate(each) if each else np.empty(0) for path, each in parts.items()}
