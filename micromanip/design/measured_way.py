"""Measured on a cell that plays a table: the ways from an input to outputs, by a sum of sines about the working point.

From set-point to gauge at two amplitudes, and what is known of it (``MeasuredWay``); from voltage to gauge, and the
gauge at rest (``quiet_loop.py``); from set-point to stage (``stage_swing.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from micromanip.rt.records import MAX_AXES
from micromanip.settings.schema.model import Configuration
from micromanip.virtual.experiment import VirtualExperiment

from . import paper
from .evaluation import SETTLE_S, TUNED, variant_of
from .experiment import EXCITED, with_reference
from .learning.zero_phase import low_pass
from .quiet_loop import QuietLoop, loop_of
from .stage_swing import StageSwing

RESTED_S = 2.0
"""For how long the sensors are looked at while nothing is played."""
_LINES_HZ = np.concatenate([np.arange(10.0, 601.0, 10.0), np.arange(650.0, 3001.0, 50.0)])
_SHAPE = np.where(_LINES_HZ <= 600.0, 1.0, 150.0 / _LINES_HZ)
_LINE_UM, _MEASURED_S = (0.2, 0.4), 8.0
"""Of the sum of sines by which T is found: its lines, their relative amplitudes, both amplitudes, and for how long."""
_MOST_OFF, _CORNER = 0.2, 2.0 / 3.0
"""Amplitudes agree to that share; of the highest frequency that is known, where Q begins to fall."""

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class MeasuredWay:
    """From set-point to position of one axis: its response (lines,) at two amplitudes."""

    small: Complex
    large: Complex

    def response(self, hertz: Array) -> Complex:
        """T (n,), straight lines between what was measured."""
        known, mean = np.append(0.0, _LINES_HZ), np.append(1.0, (self.small + 2.0 * self.large) / 3.0)
        return np.asarray(np.interp(hertz, known, mean))

    @property
    def _known(self) -> NDArray[np.bool_]:
        """At which lines, and at their neighbours, both amplitudes agree to a fifth."""
        alike = np.abs(self.large - self.small) <= _MOST_OFF * np.abs(self.small)
        return np.asarray(minimum_filter(alike, 3, mode="nearest"))

    def share(self, hertz: Array) -> Array:
        """Q (n,): 0 where T is not known at both lines beside, else 1, falling towards the highest that is known."""
        known = self._known
        if not known.any():
            return np.zeros(len(hertz))
        highest_hz = float(_LINES_HZ[known].max())
        beside = np.interp(hertz, np.append(0.0, _LINES_HZ), np.append(known[0], known).astype(float))
        return np.where((beside == 1.0) & (hertz <= highest_hz), low_pass(hertz, _CORNER * highest_hz), 0.0)

    @property
    def highest_Hz(self) -> float:
        """Up to where it is known without a gap; 0 where it nowhere is."""
        wrong = np.flatnonzero(~self._known)
        return float(_LINES_HZ[-1] if not len(wrong) else _LINES_HZ[wrong[0] - 1] if wrong[0] else 0.0)


class TurningCell:
    """A cell that plays a table without a pause; the table may be changed ahead of it."""

    def __init__(self, configuration: Configuration, experiment: VirtualExperiment, seconds: float) -> None:
        self._configuration, self._experiment = configuration, experiment
        self._rate_hz = configuration.loop.rate_hz
        self.table = np.full((round(seconds * self._rate_hz), MAX_AXES), paper.OFFSET_UM)
        axes = {name: variant_of(axis, TUNED, own_pid=False) for name, axis in configuration.axes.items()}
        variant = with_reference(configuration.model_copy(update={"axes": axes}), EXCITED)
        self._cell = experiment.cell(variant, self.table)
        self._cell.arm()

    @property
    def parameters(self) -> Any:
        """What the cell runs on."""
        return self._cell.parameters[0]

    @property
    def at(self) -> int:
        """Row of the table that was played last."""
        cell = self._cell.state[0]
        return int(cell["cycle"] - cell["tracking_cycle"])

    def run(self, seconds: float) -> tuple[int, NDArray[Any]]:
        """The next `seconds`: the row of the table that they begin with, and what was measured. CheckFailed."""
        first = self.at + 1
        rows = self._cell.run(seconds)
        self._experiment.require_no_fault(self._cell)
        return first, self._experiment.at_own_time(rows, self._configuration)


def measured_ways(configuration: Configuration, experiment: VirtualExperiment) -> dict[str, MeasuredWay]:
    """T of each axis, by a sum of sines about the working point at two amplitudes."""
    rate_hz, count = configuration.loop.rate_hz, len(configuration.axes)
    turning = TurningCell(configuration, experiment, len(_LINE_UM) * (SETTLE_S + _MEASURED_S) + 1.0)
    found = []
    for line_um in _LINE_UM:
        played, answer = _excited(turning, rate_hz, count, line_um)
        found.append({name: answer["strain_um"][:, i] * undone_lag(axis, _LINES_HZ) / played
                      for i, (name, axis) in enumerate(configuration.axes.items())})  # fmt: skip
    return {name: MeasuredWay(*(each[name] for each in found)) for name in configuration.axes}


def quiet_loops(configuration: Configuration, experiment: VirtualExperiment) -> dict[str, QuietLoop]:
    """The strain loop of each axis, by the answer of its gauge to the voltage, and by the gauge at rest."""
    rate_hz, count = configuration.loop.rate_hz, len(configuration.axes)
    turning = TurningCell(configuration, experiment, 2.0 * (SETTLE_S + _MEASURED_S) + 1.0)
    turning.run(SETTLE_S)
    _, rows = turning.run(_MEASURED_S)
    resting = np.array(rows["axis"]["strain_um"][:, :count], dtype=float)
    _, answer = _excited(turning, rate_hz, count, _LINE_UM[0])
    hertz, found = np.arange(1.0, _LINES_HZ[-1] + 0.5), {}
    for i, (name, axis) in enumerate(configuration.axes.items()):
        plant = answer["strain_um"][:, i] / answer["voltage_V"][:, i]
        inner = variant_of(axis, TUNED, own_pid=False).running_inner
        loop = loop_of(inner, 1.0 / rate_hz, hertz, _LINES_HZ, plant)
        found[name] = QuietLoop.of(hertz, loop, resting[:, i], rate_hz)
    return found


def stage_swings(configuration: Configuration, experiment: VirtualExperiment) -> dict[str, StageSwing]:
    """How far the stage goes, of each axis that has a capacitive sensor."""
    rate_hz, count = configuration.loop.rate_hz, len(configuration.axes)
    turning = TurningCell(configuration, experiment, 2.0 * SETTLE_S + RESTED_S + _MEASURED_S + 1.0)
    turning.run(SETTLE_S)
    _, rows = turning.run(RESTED_S)
    rest_um = np.median(rows["axis"]["stage_um"][:, :count], axis=0)
    played, answer = _excited(turning, rate_hz, count, _LINE_UM[0])
    answers = answer["stage_um"] / played[:, None]
    found = {}
    for i, name in enumerate(configuration.axes):
        axis = turning.parameters["axis"][i]
        if axis["stage"] >= 0:
            low_um, high_um = axis["stage_range_um"]
            found[name] = StageSwing(_LINES_HZ, answers[:, i], float(rest_um[i]), (float(low_um), float(high_um)))
    return found


def _excited(turning: TurningCell, rate_hz: int, count: int, line_um: float) -> tuple[Complex, dict[str, Complex]]:
    """Play the sum of sines on `count` axes: its lines (lines,), and those (lines, count) of what answered."""
    time_s, number = np.arange(len(turning.table)) / rate_hz, len(_LINES_HZ)
    phases = -np.pi * np.arange(number) * np.arange(1, number + 1) / number  # Schroeder's: a low crest
    wave = np.zeros(len(time_s))
    for f, size, phase in zip(_LINES_HZ, _SHAPE, phases, strict=True):
        wave += line_um * size * np.cos(2.0 * np.pi * f * time_s + phase)
    turning.table[turning.at + 1 :, range(count)] = paper.OFFSET_UM + wave[turning.at + 1 :, None]
    turning.run(SETTLE_S)
    first, rows = turning.run(_MEASURED_S)
    lines = np.round(_LINES_HZ * _MEASURED_S).astype(int)
    answer = {
        key: np.fft.rfft(rows["axis"][key][:, :count], axis=0)[lines] for key in ("strain_um", "stage_um", "voltage_V")
    }
    return np.fft.rfft(wave[first:][: len(rows)])[lines], answer


def undone_lag(axis: Any, hertz: Array) -> Complex:
    """What the gauge's own lag is undone by, at `hertz`."""
    lag_s = 0.0 if axis.actuator is None else 1e-6 * axis.actuator.gauge_us
    return np.asarray(1.0 + 2j * np.pi * hertz * lag_s)
