"""Experiments in virtual time: a configuration, armed, for so many seconds; each sample at its own time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.rt.telemetry import ROW
from micromanip.settings.check import Prepared
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.places import Wiring
from micromanip.settings.wiring.timing import AT_ONCE, FeedbackPath, feedback_path

from .cell import Rows, Samples, VirtualCell

# A bus delivers a sample rarely and late, and takes a voltage rarely and late; a wire that is waited for delivers some
# late; and while the loop misses cycles, plant and sensors go on. What is fitted to such rows would take the ways for
# dynamics of the actuator, and for hysteresis, and samples that stand still for noise. So each sensor's column becomes
# a line through its samples, each at the time at which it was taken, and the voltage moves on by the output's way.

_FRESH = {"strain": 1, "stage": 2}


def at_own_time(rows: NDArray[Any], configuration: Configuration, wiring: Wiring) -> NDArray[Any]:
    """The same rows where every sample was of its own cycle; else a copy with the columns moved.

    Of a cycle that was missed there is the row of the one before once more.
    """
    paths = [feedback_path(configuration, wiring, axis) for axis in configuration.axes]
    if not len(rows):
        return rows
    missed = _missed(rows["cycle"])
    at_once = all(path == AT_ONCE for path in paths) and not missed.any()
    if at_once and not _has_late(rows["axis"][:, : len(paths)]):
        return rows
    moved, period_ns = rows.copy(), configuration.loop.period_ns
    time_ns = rows["time_ns"] + missed * period_ns
    for i, path in enumerate(paths):
        axis, out = rows["axis"][:, i], moved["axis"][:, i]
        for sensor, bit in _FRESH.items():
            fresh = ((axis["fresh"] & bit) != 0) & (missed == 0)
            if not fresh.any():
                continue
            taken_ns = (time_ns - axis[f"{sensor}_age_ns"])[fresh]
            out[f"{sensor}_um"] = np.interp(time_ns, taken_ns, axis[f"{sensor}_um"][fresh])
        late_ns = path.output_late * period_ns
        out["voltage_V"] = np.interp(time_ns - late_ns, time_ns, axis["voltage_V"])
    return moved


def _has_late(axes: NDArray[Any]) -> bool:
    """Whether any sensor that there is (rows, axes) has a sample that is not of its row."""
    for sensor, bit in _FRESH.items():
        fresh = (axes["fresh"] & bit) != 0
        late = ~fresh | (axes[f"{sensor}_age_ns"] > 0)
        if late[:, fresh.any(axis=0)].any():
            return True
    return False


def _missed(cycle: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of each row how many cycles after that of its number it stands."""
    place = np.arange(len(cycle))
    first = np.diff(cycle, prepend=cycle[0] - 1) != 0
    return place - np.maximum.accumulate(np.where(first, place, 0))


def with_options(prepared: Prepared, name: str, options: Any) -> Prepared:
    """The cell with its simulated driver `name` built anew of `options`, the rest as it is."""
    wiring = prepared.wiring
    driver = type(wiring.drivers[name])(options, prepared.configuration.loop.period_ns)
    drivers, told = {**wiring.drivers, name: driver}, {**wiring.options, name: options}
    return replace(prepared, wiring=replace(wiring, drivers=drivers, options=told))


class VirtualExperiment:
    """Runs variants of one configuration on fresh copies of its simulated drivers.

    Calling it arms `configuration`, waits until every axis tracks, and returns the telemetry rows (one in
    `every` cycles) of the following `seconds`. `samples` (n, MAX_AXES) is what the source `file` plays.
    Raises CheckFailed where the cell does not come to TRACKING, or a fault ends the experiment.
    """

    def __init__(
        self, prepared: Prepared, *, process: bool = False, say: Callable[[str], None] = lambda _: None
    ) -> None:
        """`process` keeps the machining force, which an experiment is normally free of.

        `say` hears of each second that begins, as "second 3 of 13".
        """
        self._say = say
        drivers = prepared.wiring.drivers
        kept = {name: driver if process else driver.without_process() for name, driver in drivers.items()}
        self._wiring = replace(prepared.wiring, drivers=kept)

    def __call__(
        self, configuration: Configuration, seconds: float, samples: Samples | None = None, every: int = 1
    ) -> Rows:
        """The rows of `seconds` after tracking has begun, each sample at its own time."""
        cell = self.cell(configuration, samples)
        period_s = configuration.loop.period_ns * 1e-9
        cycles, part = round(seconds / period_s), max(1, round(1.0 / period_s) // every) * every
        try:
            cell.arm(every=part)  # nobody reads them: a row is as long as what it takes to compute a cycle
        except CheckFailed:
            self.require_no_fault(cell)
            raise
        rows = np.zeros(cycles // every, ROW)
        for begin in range(0, max(cycles, 1), part):
            self._say(f"second {begin // part + 1} of {-(-cycles // part)}")
            part_s = min(part, cycles - begin) * period_s
            cell.run(part_s, every, rows=rows[begin // every : (begin + part) // every])
        self.require_no_fault(cell)
        return self.at_own_time(rows, configuration)

    def at_own_time(self, rows: Rows, configuration: Configuration) -> Rows:
        """`rows` with each sample at its own time."""
        return at_own_time(rows, configuration, self._wiring)

    def require_no_fault(self, cell: VirtualCell) -> None:
        """Raise CheckFailed where `cell` has a fault latched."""
        for fault in cell.faults():
            raise CheckFailed(f"the experiment was ended by a fault: {fault}")

    def path(self, configuration: Configuration, axis: str) -> FeedbackPath:
        """What the sensors and the output of `axis` take."""
        return feedback_path(configuration, self._wiring, axis)

    def cell(self, configuration: Configuration, samples: Samples | None = None) -> VirtualCell:
        """The cell itself, READY, for whoever wants to step it."""
        return VirtualCell(compile_cell(configuration, self._wiring), self._wiring, samples, list(configuration.axes))
