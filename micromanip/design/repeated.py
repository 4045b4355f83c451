"""E of `evaluate`: D on a sine that is repeated, with what repeats of its error taken off the set-point beforehand.

The law is that of learning from part to part (`learning/law.py`) on one period as the part: with the error E_k of
repetition k at a harmonic of the sine, the correction C_k that was played in it and the measured way T from set-point
to position, ``E_k + T C_k`` is what would be there uncorrected. Its mean over the repetitions is m, and
``C = Q W m / T``. T is measured by a sum of sines, at two amplitudes: where the two differ by more than a fifth, as
beside a sharp resonance, it is not known, and Q is 0. W is the confidence of `learning/spectrum.py`, by harmonics.

What repeats need not be fed back, and feedback makes motion of the gauge's noise. So each sine is learned with all of
the PID's gains and with shares of them, and E is that of which the gauge tells the least: what repeats of its error by
its own words, and what does not by the loop (`quiet_loop.py`).

The sine never stops: each repetition follows the one before, and the correction changes over as minimum jerk. A period
that is continued has no ends, so harmonics are all there is, and no band about them plays noise. What is learned from
is the gauge, less its own lag and less the lines of the mains that it shows at rest: they would be played as motion.
The true position is only told. A sine that the stage would not bear (`stage_swing.py`) is not played to its axis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from micromanip.errors import CheckFailed
from micromanip.rt.laws.minimum_jerk import minimum_jerk
from micromanip.rt.records import MAX_AXES
from micromanip.settings.schema.model import Configuration
from micromanip.virtual.experiment import VirtualExperiment

from . import paper
from .evaluation import SETTLE_S, TUNED, variant_of
from .experiment import EXCITED, with_reference
from .learning.spectrum import believed
from .learning.zero_phase import low_pass
from .quiet_loop import MAINS_HZ, SHARES, QuietLoop, loop_of
from .stage_swing import StageSwing

LEARNED = "E"
REPETITIONS = 8
WINDOW_S = 1.0
"""What of a repetition is looked at: whole periods of all the frequencies below."""
SINES = ((1.0, 30.0), (5.0, 30.0), (10.0, 30.0), (50.0, 10.0), (100.0, 10.0), (150.0, 10.0))
"""Hz and um."""
ASKED_UM = {1.0: 0.010, 5.0: 0.012, 10.0: 0.012, 100.0: 0.020}
ASKED_PERCENT = {50.0: 0.15, 150.0: 0.30}
"""True sigma, and rms in percent of the stroke: what was to be reached."""
_LINES_HZ = np.concatenate([np.arange(10.0, 601.0, 10.0), np.arange(650.0, 3001.0, 50.0)])
_SHAPE = np.where(_LINES_HZ <= 600.0, 1.0, 150.0 / _LINES_HZ)
_LINE_UM, _MEASURED_S = (0.2, 0.4), 8.0
"""Of the sum of sines by which T is found: its lines, their relative amplitudes, both amplitudes, and for how long."""
_RESTED_S = 2.0
_MOST_OFF, _CORNER = 0.2, 2.0 / 3.0
_FADE_S, _CHANGED_S = 0.05, 0.2
"""A correction changes over in that time, and has settled after that."""
_LIMIT_UM = 5.0
_LAST = 3
"""A repetition counts for 1 of so many at least: what T is wrong by goes with each, a mean of all would keep it."""
_SEEN = 4
"""Repetitions that are told of."""
_INDEPENDENT = 2.0
"""Degrees of freedom of a harmonic in one repetition."""

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


class Harmonics:
    """What is learned of one axis, at the harmonics (n,) of its sine."""

    def __init__(self, hertz: Array, way: MeasuredWay) -> None:
        """Nothing yet."""
        self._response = way.response(hertz)
        self._low = way.share(hertz)
        self._mean, self._spread = np.zeros(len(hertz), complex), np.zeros(len(hertz))
        self._repetitions = 0
        self.correction = np.zeros(len(hertz), complex)

    def learn(self, error: Complex) -> None:
        """Take the `error` (n,) that was left while `correction` was played."""
        alone = error + self._response * self.correction
        self._repetitions += 1
        n, before = min(self._repetitions, _LAST), self._mean
        self._mean = before + (alone - before) / n
        if n > 1:
            apart = ((alone - before) * np.conj(alone - self._mean)).real
            self._spread += (apart - self._spread) / (n - 1)
        power = np.abs(self._mean) ** 2
        sure = believed(power, self._spread if n > 1 else power, n, _INDEPENDENT)
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


def repeated(
    configuration: Configuration, experiment: VirtualExperiment, repetitions: int = REPETITIONS,
    progress: Callable[[], None] = lambda: None,
) -> list[dict[str, Any]]:  # fmt: skip
    """A row for each axis and sine, after `repetitions` of it; `progress` is called after each sine."""
    loops, found = quiet_loops(configuration, experiment), []
    swings = stage_swings(configuration, experiment)
    tuned = [(share, _with_share(configuration, loops, share)) for share in SHARES]
    ways = {share: measured_ways(each, experiment) for share, each in tuned}
    for sine in SINES:
        refused = {name: why for name, swing in swings.items() if (why := swing.refusal(*sine)) is not None}
        found += [_refused(name, *sine, repetitions, why) for name, why in refused.items()]
        borne = [name for name in configuration.axes if name not in refused]
        tried, problems = [], []
        for share, each in tuned if borne else ():
            try:
                tried.append(_sine(each, experiment, borne, ways[share], loops, share, *sine, repetitions))
            except CheckFailed as problem:
                problems.append(problem)
        if problems and not tried:
            found += [_refused(name, *sine, repetitions, str(problems[0])) for name in borne]
        found += [min(of_axis, key=itemgetter(0))[1] for of_axis in zip(*tried, strict=True)]
        progress()
    order = {name: i for i, name in enumerate(configuration.axes)}
    return sorted(found, key=lambda row: order[row["axis"]])


def quiet_loops(configuration: Configuration, experiment: VirtualExperiment) -> dict[str, QuietLoop]:
    """The strain loop of each axis, by the answer of its gauge to the voltage, and by the gauge at rest."""
    rate_hz, count = configuration.loop.rate_hz, len(configuration.axes)
    turning = _Turning(configuration, experiment, 2.0 * (SETTLE_S + _MEASURED_S) + 1.0)
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
    turning = _Turning(configuration, experiment, 2.0 * SETTLE_S + _RESTED_S + _MEASURED_S + 1.0)
    turning.run(SETTLE_S)
    _, rows = turning.run(_RESTED_S)
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


def _with_share(configuration: Configuration, loops: dict[str, QuietLoop], share: float) -> Configuration:
    """`configuration` with `share` of the PID's gains on each axis that bears it."""
    axes = dict(configuration.axes)
    for name, axis in configuration.axes.items():
        if loops[name].bears(share):
            inner = axis.inner.model_copy(update={"K_V_per_um": share * axis.inner.K_V_per_um})
            axes[name] = axis.model_copy(update={"inner": inner})
    return configuration.model_copy(update={"axes": axes})


def measured_ways(configuration: Configuration, experiment: VirtualExperiment) -> dict[str, MeasuredWay]:
    """T of each axis, by a sum of sines about the working point at two amplitudes."""
    rate_hz, count = configuration.loop.rate_hz, len(configuration.axes)
    turning = _Turning(configuration, experiment, len(_LINE_UM) * (SETTLE_S + _MEASURED_S) + 1.0)
    found = []
    for line_um in _LINE_UM:
        played, answer = _excited(turning, rate_hz, count, line_um)
        found.append({name: answer["strain_um"][:, i] * _undone(axis, _LINES_HZ) / played
                      for i, (name, axis) in enumerate(configuration.axes.items())})  # fmt: skip
    return {name: MeasuredWay(*(each[name] for each in found)) for name in configuration.axes}


def _excited(turning: _Turning, rate_hz: int, count: int, line_um: float) -> tuple[Complex, dict[str, Complex]]:
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


def _undone(axis: Any, hertz: Array) -> Complex:
    """What the gauge's own lag is undone by, at `hertz`."""
    lag_s = 0.0 if axis.actuator is None else 1e-6 * axis.actuator.gauge_us
    return np.asarray(1.0 + 2j * np.pi * hertz * lag_s)


def _sine(
    configuration: Configuration, experiment: VirtualExperiment, names: list[str], ways: dict[str, MeasuredWay],
    loops: dict[str, QuietLoop], share: float, frequency_hz: float, amplitude_um: float, repetitions: int,
) -> list[tuple[float, dict[str, Any]]]:  # fmt: skip
    """A row for each axis of `names`, and the mean square (um^2) of its position's error that the gauge tells of.

    The other axes stay at rest.
    """
    rate_hz, window = configuration.loop.rate_hz, round(WINDOW_S * configuration.loop.rate_hz)
    pause_s = np.ceil(_CHANGED_S * frequency_hz) / frequency_hz
    seconds = 2.0 * SETTLE_S + _RESTED_S + (repetitions + 2) * (WINDOW_S + pause_s) + _SEEN * WINDOW_S
    turning = _Turning(configuration, experiment, seconds)
    turns = round(frequency_hz * WINDOW_S)
    lines = np.arange(turns, window // 2, turns)
    hertz = np.asarray(lines / WINDOW_S, dtype=np.float64)
    columns = [list(configuration.axes).index(name) for name in names]
    shares = [share if loops[name].bears(share) else 1.0 for name in names]
    turning.run(SETTLE_S)
    first, rows = turning.run(_RESTED_S)
    mains = []
    for i, name in enumerate(names):
        # at rest the gauge shows S of what it adds
        shown = _lines(rows["axis"]["strain_um"][:, columns[i]], first, lines, window).mean(axis=0)
        shown[~np.isin(hertz, MAINS_HZ)] = 0.0
        mains.append(shown / loops[name].sensitivity(shares[i], hertz))
    # the sine begins with a window: no step
    time_s, begins = np.arange(len(turning.table)) / rate_hz, (turning.at // window + 1) * window
    sine = paper.OFFSET_UM + amplitude_um * np.sin(2.0 * np.pi * frequency_hz * time_s) * (time_s * rate_hz >= begins)

    def left(first: int, rows: NDArray[Any], i: int) -> Complex:
        """The error (windows, lines) of an axis, as its gauge tells it: less its lag, and what it adds itself."""
        seen = _lines(rows["axis"]["strain_um"][:, columns[i]], first, lines, window) - mains[i]
        wanted = _lines(sine[first:][: len(rows)], first, lines, window)
        return np.asarray(wanted - seen * _undone(configuration.axes[names[i]], hertz))

    harmonics = {name: Harmonics(hertz, ways[name]) for name in names}
    fade = np.array([minimum_jerk(k / (_FADE_S * rate_hz)) for k in range(round(_FADE_S * rate_hz))])
    now = np.zeros((window, len(names)))
    turning.table[turning.at + 1 :, columns] = sine[turning.at + 1 :, None]
    turning.run(WINDOW_S + max(SETTLE_S, 1.0 / frequency_hz))
    for _ in range(repetitions):
        first, rows = turning.run(WINDOW_S)
        for i, name in enumerate(names):
            harmonics[name].learn(left(first, rows, i)[0])
        now = _changed(turning, columns, sine, now, _waves(harmonics, lines, window), fade)
        turning.run(pause_s)
    first, rows = turning.run(_SEEN * WINDOW_S)
    whole = sine[first:][: len(rows)]
    found: list[tuple[float, dict[str, Any]]] = []
    for i, name in enumerate(names):
        expected_um2 = loops[name].motion_um2(shares[i], hertz) + _repeats_um2(left(first, rows, i))
        row = _row(name, frequency_hz, amplitude_um, repetitions, whole, rows["axis"][:, columns[i]], ways[name])
        found.append((expected_um2, row | {"feedback_percent": 100.0 * shares[i]}))
    return found


def _lines(values: Array, first: int, lines: NDArray[np.int64], window: int) -> Complex:
    """Lines (windows, lines) of `values`, which begin with row `first` of the table, as if with row 0."""
    turned = np.exp(-2j * np.pi * lines * (first % window) / window)
    return np.asarray(np.fft.rfft(values.reshape(-1, window), axis=1)[:, lines] * turned / window)


def _repeats_um2(error: Complex) -> float:
    """Mean square of what is the same in every window of `error` (windows, lines), beyond what chance makes."""
    power = np.abs(error.mean(axis=0)) ** 2
    return float(2.0 * np.sum(power * believed(power, error.var(axis=0, ddof=1), len(error), _INDEPENDENT)))


def _waves(harmonics: dict[str, Harmonics], lines: NDArray[np.int64], window: int) -> Array:
    """The corrections (window, axes), um, beginning with the table."""
    spectra = np.zeros((window // 2 + 1, len(harmonics)), complex)
    for i, each in enumerate(harmonics.values()):
        spectra[lines, i] = each.correction * window
    found = np.fft.irfft(spectra, window, axis=0)
    if (peak_um := float(np.abs(found).max())) > _LIMIT_UM:
        raise CheckFailed(f"the correction would be {peak_um:.3g} um, at most {_LIMIT_UM:g} um may be: not applied")
    return np.asarray(found)


def _changed(turning: _Turning, columns: list[int], sine: Array, before: Array, after: Array, fade: Array) -> Array:
    """Play `after` (window, columns) on top of `sine` in the place of `before`, from now on; `after`."""
    at = np.arange(turning.at + 1, len(turning.table))
    share = np.ones(len(at))
    share[: len(fade)] = fade[: len(at)]
    old, new = before[at % len(before)], after[at % len(after)]
    turning.table[at[:, None], columns] = sine[at, None] + old + share[:, None] * (new - old)
    return after


def _row(
    name: str, frequency_hz: float, amplitude_um: float, repetitions: int, wanted: Array, axis: NDArray[Any],
    way: MeasuredWay,
) -> dict[str, Any]:  # fmt: skip
    error, true = wanted - axis["strain_um"], wanted - axis["true_strain_um"]
    apart = true.reshape(_SEEN, -1)
    floor_um = np.sqrt(np.sum((apart - apart.mean(axis=0)) ** 2) / (apart.size - apart.shape[1]))
    return {
        "axis": name, "frequency_hz": frequency_hz, "config": LEARNED, "amplitude_um": amplitude_um,
        "repetitions": repetitions, "std_error_um": float(error.std()), "max_error_um": float(np.abs(error).max()),
        "true_std_error_um": float(true.std()), "true_max_error_um": float(np.abs(true).max()),
        "true_rms_percent": float(100.0 * np.sqrt(np.mean(true**2)) / (2.0 * amplitude_um)),
        "floor_um": float(floor_um), "known_to_hz": way.highest_Hz,
        "refused": None, **_asked(frequency_hz),
    }  # fmt: skip


def _refused(name: str, frequency_hz: float, amplitude_um: float, repetitions: int, why: str) -> dict[str, Any]:
    """A row without figures, of a sine that was not played."""
    figures = (
        "std_error_um", "max_error_um", "true_std_error_um", "true_max_error_um", "true_rms_percent", "floor_um",
        "known_to_hz", "feedback_percent",
    )  # fmt: skip
    return {
        "axis": name, "frequency_hz": frequency_hz, "config": LEARNED, "amplitude_um": amplitude_um,
        "repetitions": repetitions, **dict.fromkeys(figures), "refused": why, **_asked(frequency_hz),
    }  # fmt: skip


def _asked(frequency_hz: float) -> dict[str, float | None]:
    return {
        "asked_true_std_error_um": ASKED_UM.get(frequency_hz),
        "asked_true_rms_percent": ASKED_PERCENT.get(frequency_hz),
    }
