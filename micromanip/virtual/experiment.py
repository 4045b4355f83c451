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
from micromanip.settings.wiring.timing import FeedbackPath, feedback_path

from .cell import Rows, Samples, VirtualCell
from .own_time import at_own_time


def with_options(prepared: Prepared, name: str, options: Any) -> Prepared:
    """The cell with its simulated driver `name` built anew of `options`, the rest as it is."""
    wiring = prepared.wiring
    driver = type(wiring.drivers[name])(options, prepared.configuration.loop.period_ns)
    drivers, told = {**wiring.drivers, name: driver}, {**wiring.options, name: options}
    return replace(prepared, wiring=replace(wiring, drivers=drivers, options=told))


def at_limit(configuration: Configuration, axis: str, voltage_V: Samples, setpoint_um: Samples) -> NDArray[np.bool_]:
    """In which cycles (n,) the voltage or the set-point of `axis` is at an end of its range."""
    low_V, high_V = configuration.outputs[f"voltage_{axis}"].range_V
    low, high = configuration.axes[axis].setpoint.range_um
    return np.asarray((voltage_V <= low_V) | (voltage_V >= high_V) | (setpoint_um <= low) | (setpoint_um >= high))


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
