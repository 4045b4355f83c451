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
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.rt.laws.minimum_jerk import minimum_jerk
from micromanip.settings.schema.model import Configuration
from micromanip.virtual.experiment import VirtualExperiment

from . import paper
from .evaluation import SETTLE_S
from .learning.spectrum import believed
from .measured_way import (
    RESTED_S,
    Array,
    Complex,
    MeasuredWay,
    TurningCell,
    measured_ways,
    quiet_loops,
    stage_swings,
    undone_lag,
)
from .quiet_loop import MAINS_HZ, SHARES, QuietLoop

LEARNED = "E"
REPETITIONS = 8
WINDOW_S = 1.0
"""What of a repetition is looked at: whole periods of all the frequencies below."""
SINES = ((1.0, 30.0), (5.0, 30.0), (10.0, 30.0), (50.0, 10.0), (100.0, 10.0), (150.0, 10.0))
"""Hz and um."""
ASKED_UM = {1.0: 0.010, 5.0: 0.012, 10.0: 0.012, 100.0: 0.020}
ASKED_PERCENT = {50.0: 0.15, 150.0: 0.30}
"""True sigma, and rms in percent of the stroke: what was to be reached."""
_FADE_S, _CHANGED_S = 0.05, 0.2
"""A correction changes over in that time, and has settled after that."""
_LIMIT_UM = 5.0
_LAST = 3
"""A repetition counts for 1 of so many at least: what T is wrong by goes with each, a mean of all would keep it."""
_SEEN = 4
"""Repetitions that are told of."""
_INDEPENDENT = 2.0
"""Degrees of freedom of a harmonic in one repetition."""


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


def _with_share(configuration: Configuration, loops: dict[str, QuietLoop], share: float) -> Configuration:
    """`configuration` with `share` of the PID's gains on each axis that bears it."""
    axes = dict(configuration.axes)
    for name, axis in configuration.axes.items():
        if loops[name].bears(share):
            inner = axis.inner.model_copy(update={"K_V_per_um": share * axis.inner.K_V_per_um})
            axes[name] = axis.model_copy(update={"inner": inner})
    return configuration.model_copy(update={"axes": axes})


def _sine(
    configuration: Configuration, experiment: VirtualExperiment, names: list[str], ways: dict[str, MeasuredWay],
    loops: dict[str, QuietLoop], share: float, frequency_hz: float, amplitude_um: float, repetitions: int,
) -> list[tuple[float, dict[str, Any]]]:  # fmt: skip
    """A row for each axis of `names`, and the mean square (um^2) of its position's error that the gauge tells of.

    The other axes stay at rest.
    """
    rate_hz, window = configuration.loop.rate_hz, round(WINDOW_S * configuration.loop.rate_hz)
    pause_s = np.ceil(_CHANGED_S * frequency_hz) / frequency_hz
    seconds = 2.0 * SETTLE_S + RESTED_S + (repetitions + 2) * (WINDOW_S + pause_s) + _SEEN * WINDOW_S
    turning = TurningCell(configuration, experiment, seconds)
    turns = round(frequency_hz * WINDOW_S)
    lines = np.arange(turns, window // 2, turns)
    hertz = np.asarray(lines / WINDOW_S, dtype=np.float64)
    columns = [list(configuration.axes).index(name) for name in names]
    shares = [share if loops[name].bears(share) else 1.0 for name in names]
    turning.run(SETTLE_S)
    first, rows = turning.run(RESTED_S)
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
        return np.asarray(wanted - seen * undone_lag(configuration.axes[names[i]], hertz))

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


def _changed(turning: TurningCell, columns: list[int], sine: Array, before: Array, after: Array, fade: Array) -> Array:
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
