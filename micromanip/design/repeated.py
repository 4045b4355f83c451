"""E of `evaluate`: D on a sine that is repeated, with what repeats of its error taken off the set-point beforehand.

The law is that of learning from part to part (`learning/law.py`) on one period as the part: with the error E_k of
repetition k at a harmonic of the sine, the correction C_k that was played in it and the measured way T from set-point
to position, ``E_k + T C_k`` is what would be there uncorrected. Its mean over the repetitions is m, and
``C = Q W m / T``. T is measured by a sum of sines, at two amplitudes: as far as the two differ it is not known, and Q
ends where that is more than a fifth. W is Wiener's gain by the spread from repetition to repetition.

The sine never stops: each repetition follows the one before, and the correction changes over as minimum jerk. A period
that is continued has no ends, so harmonics are all there is, and no band about them plays noise. What is learned from
is the gauge, less its own lag; the true position is only told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.rt.laws.minimum_jerk import minimum_jerk
from micromanip.rt.records import MAX_AXES
from micromanip.settings.schema.model import Configuration
from micromanip.virtual.experiment import VirtualExperiment

from . import paper
from .evaluation import SETTLE_S, TUNED, variant_of
from .experiment import EXCITED, with_reference
from .learning.zero_phase import low_pass

LEARNED = "E"
REPETITIONS = 8
WINDOW_S = 1.0
"""What of a repetition is looked at: whole periods of all the frequencies below."""
SINES = ((1.0, 30.0), (5.0, 30.0), (10.0, 30.0), (50.0, 10.0), (100.0, 10.0), (150.0, 10.0))
"""Hz and um."""
ASKED_UM = {1.0: 0.010, 5.0: 0.012, 10.0: 0.012, 100.0: 0.020}
ASKED_PERCENT = {50.0: 0.15, 150.0: 0.30}
"""True sigma, and rms in percent of the stroke: what was to be reached."""
_LINES_HZ, _LINE_UM = np.arange(10.0, 601.0, 10.0), (0.2, 0.4)
_MOST_OFF, _CORNER = 0.2, 2.0 / 3.0
_FADE_S, _CHANGED_S = 0.05, 0.2
"""A correction changes over in that time, and has settled after that."""
_LIMIT_UM = 5.0

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class MeasuredWay:
    """From set-point to position of one axis: its response (lines,) at two amplitudes."""

    small: Complex
    large: Complex

    def response(self, hertz: Array) -> Complex:
        """T (n,), straight lines between what was measured."""
        known, mean = np.append(0.0, _LINES_HZ), np.append(1.0, 0.5 * (self.small + self.large))
        return np.asarray(np.interp(hertz, known, mean.real) + 1j * np.interp(hertz, known, mean.imag))

    @property
    def highest_Hz(self) -> float:
        """Up to where both amplitudes agree to a fifth; 0 where they nowhere do."""
        off = np.abs(self.large - self.small) / np.abs(self.small)
        wrong = np.flatnonzero(~(off <= _MOST_OFF))
        return float(_LINES_HZ[-1] if not len(wrong) else _LINES_HZ[wrong[0] - 1] if wrong[0] else 0.0)


class Harmonics:
    """What is learned of one axis, at the harmonics (n,) of its sine."""

    def __init__(self, hertz: Array, way: MeasuredWay) -> None:
        """Nothing yet."""
        self._response = way.response(hertz)
        corner_hz = _CORNER * way.highest_Hz
        self._low = low_pass(hertz, corner_hz) if corner_hz else np.zeros(len(hertz))
        self._low[hertz > way.highest_Hz] = 0.0
        self._mean, self._spread = np.zeros(len(hertz), complex), np.zeros(len(hertz))
        self._repetitions = 0
        self.correction = np.zeros(len(hertz), complex)

    def learn(self, error: Complex) -> None:
        """Take the `error` (n,) that was left while `correction` was played."""
        alone = error + self._response * self.correction
        self._repetitions += 1
        n, before = self._repetitions, self._mean
        self._mean = before + (alone - before) / n
        if n > 1:
            apart = ((alone - before) * np.conj(alone - self._mean)).real
            self._spread += (apart - self._spread) / (n - 1)
        power = np.abs(self._mean) ** 2
        chance = np.divide(self._spread, n * power, out=np.ones(len(power)), where=power > 0.0)
        sure = np.clip(1.0 - chance, 0.0, 1.0)
        self.correction = self._low * sure * self._mean / self._response


class _Turning:
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


def repeated(
    configuration: Configuration, experiment: VirtualExperiment, repetitions: int = REPETITIONS,
    progress: Callable[[], None] = lambda: None,
) -> list[dict[str, Any]]:  # fmt: skip
    """A row for each axis and sine, after `repetitions` of it; `progress` is called after each sine."""
    ways = measured_ways(configuration, experiment)
    found = []
    for frequency_hz, amplitude_um in SINES:
        found += _sine(configuration, experiment, ways, frequency_hz, amplitude_um, repetitions)
        progress()
    order = {name: i for i, name in enumerate(configuration.axes)}
    return sorted(found, key=lambda row: order[row["axis"]])


def measured_ways(configuration: Configuration, experiment: VirtualExperiment) -> dict[str, MeasuredWay]:
    """T of each axis, by a sum of sines about the working point at two amplitudes."""
    rate_hz, window = configuration.loop.rate_hz, round(WINDOW_S * configuration.loop.rate_hz)
    turning = _Turning(configuration, experiment, len(_LINE_UM) * (SETTLE_S + WINDOW_S) + 1.0)
    time_s = np.arange(len(turning.table)) / rate_hz
    count = len(_LINES_HZ)
    phases = -np.pi * np.arange(count) * np.arange(1, count + 1) / count  # Schroeder's: a low crest
    wave = np.sum(
        [np.cos(2.0 * np.pi * f * time_s + phase) for f, phase in zip(_LINES_HZ, phases, strict=True)], axis=0
    )
    columns = range(len(configuration.axes))
    found = []
    lines = np.round(_LINES_HZ * WINDOW_S).astype(int)
    for line_um in _LINE_UM:
        turning.table[turning.at + 1 :, columns] = paper.OFFSET_UM + line_um * wave[turning.at + 1 :, None]
        turning.run(SETTLE_S)
        first, rows = turning.run(WINDOW_S)
        played = np.fft.rfft(line_um * wave[first:][:window])[lines]
        moved = np.fft.rfft(rows["axis"]["strain_um"], axis=0)[lines]
        found.append({name: moved[:, i] * _undone(axis, _LINES_HZ) / played
                      for i, (name, axis) in enumerate(configuration.axes.items())})  # fmt: skip
    return {name: MeasuredWay(*(each[name] for each in found)) for name in configuration.axes}


def _undone(axis: Any, hertz: Array) -> Complex:
    """What the gauge's own lag is undone by, at `hertz`."""
    lag_s = 0.0 if axis.actuator is None else 1e-6 * axis.actuator.gauge_us
    return np.asarray(1.0 + 2j * np.pi * hertz * lag_s)


def _sine(
    configuration: Configuration, experiment: VirtualExperiment, ways: dict[str, MeasuredWay], frequency_hz: float,
    amplitude_um: float, repetitions: int,
) -> list[dict[str, Any]]:  # fmt: skip
    rate_hz, window = configuration.loop.rate_hz, round(WINDOW_S * configuration.loop.rate_hz)
    pause_s = np.ceil(_CHANGED_S * frequency_hz) / frequency_hz
    turning = _Turning(configuration, experiment, SETTLE_S + (repetitions + 2) * (WINDOW_S + pause_s) + 2.0 * WINDOW_S)
    turns = round(frequency_hz * WINDOW_S)
    lines = np.arange(turns, window // 2, turns)
    hertz = np.asarray(lines / WINDOW_S, dtype=np.float64)
    time_s = np.arange(len(turning.table)) / rate_hz
    sine = paper.OFFSET_UM + amplitude_um * np.sin(2.0 * np.pi * frequency_hz * time_s)
    # the table begins where the sine is at its working point: no step
    harmonics = {name: Harmonics(hertz, way) for name, way in ways.items()}
    fade = np.array([minimum_jerk(k / (_FADE_S * rate_hz)) for k in range(round(_FADE_S * rate_hz))])
    now = np.zeros((window, len(harmonics)))
    turning.table[turning.at + 1 :, range(len(harmonics))] = sine[turning.at + 1 :, None]
    turning.run(max(SETTLE_S, 1.0 / frequency_hz))
    for _ in range(repetitions):
        first, rows = turning.run(WINDOW_S)
        turned = np.exp(-2j * np.pi * lines * (first % window) / window)
        for i, (name, axis) in enumerate(configuration.axes.items()):
            # of the sine itself and of what was measured apart: only the gauge has a lag
            wanted, seen = (
                np.fft.rfft(each)[lines] for each in (sine[first:][:window], rows["axis"]["strain_um"][:, i])
            )
            harmonics[name].learn((wanted - seen * _undone(axis, hertz)) * turned / window)
        now = _changed(turning, sine, now, _waves(harmonics, lines, window), fade)
        turning.run(pause_s)
    first, rows = turning.run(2.0 * WINDOW_S)
    whole = sine[first:][: 2 * window]
    return [
        _row(name, frequency_hz, amplitude_um, repetitions, whole, rows["axis"][:, i], ways[name])
        for i, name in enumerate(configuration.axes)
    ]


def _waves(harmonics: dict[str, Harmonics], lines: NDArray[np.int64], window: int) -> Array:
    """The corrections (window, axes), um, beginning with the table."""
    spectra = np.zeros((window // 2 + 1, len(harmonics)), complex)
    for i, each in enumerate(harmonics.values()):
        spectra[lines, i] = each.correction * window
    found = np.fft.irfft(spectra, window, axis=0)
    if (peak_um := float(np.abs(found).max())) > _LIMIT_UM:
        raise CheckFailed(f"the correction would be {peak_um:.3g} um, at most {_LIMIT_UM:g} um may be: not applied")
    return np.asarray(found)


def _changed(turning: _Turning, sine: Array, before: Array, after: Array, fade: Array) -> Array:
    """Play `after` (window, axes) on top of `sine` in the place of `before`, from now on; `after`."""
    at = np.arange(turning.at + 1, len(turning.table))
    share = np.ones(len(at))
    share[: len(fade)] = fade[: len(at)]
    old, new = before[at % len(before)], after[at % len(after)]
    turning.table[at, : before.shape[1]] = sine[at, None] + old + share[:, None] * (new - old)
    return after


def _row(
    name: str, frequency_hz: float, amplitude_um: float, repetitions: int, wanted: Array, axis: NDArray[Any],
    way: MeasuredWay,
) -> dict[str, Any]:  # fmt: skip
    error, true = wanted - axis["strain_um"], wanted - axis["true_strain_um"]
    apart = true.reshape(2, -1)
    floor_um = np.sqrt(np.sum((apart - apart.mean(axis=0)) ** 2) / (apart.size - apart.shape[1]))
    return {
        "axis": name, "frequency_hz": frequency_hz, "config": LEARNED, "amplitude_um": amplitude_um,
        "repetitions": repetitions, "std_error_um": float(error.std()), "max_error_um": float(np.abs(error).max()),
        "true_std_error_um": float(true.std()), "true_max_error_um": float(np.abs(true).max()),
        "true_rms_percent": float(100.0 * np.sqrt(np.mean(true**2)) / (2.0 * amplitude_um)),
        "floor_um": float(floor_um), "known_to_hz": way.highest_Hz,
        "asked_true_std_error_um": ASKED_UM.get(frequency_hz),
        "asked_true_rms_percent": ASKED_PERCENT.get(frequency_hz),
    }  # fmt: skip
