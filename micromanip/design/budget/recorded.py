"""The budget of a recording: what the recorded signals show of each cause, carried through the laws that ran.

With the path d, the samples' noise n, and what disturbs the stage, ``v = y - G u`` (u the recorded set-point, G the
model of the stage), the loop's equations (``loop.py``) are an identity of recorded signals:

    e = d - y = (d - T d~) - T n~ - S v + G Y S m

d~ and n~ are path and noise behind the predictor, T its way to the stage, S the sensitivity, m the capacitive sensor's
noise. What a simulation knows is taken as it is: path, stage, and the motion of a copy that nobody controls, which
shows the force. Else the path is the tracker's, smoothed without lag (a low pass of zero phase, beyond what stands out
of the floor of the samples' spectrum), y is the measured position, and the sensor's noise is told from the rest by its
configured size.

What these parts do not explain is left as a remainder: where cycles were missing or a limit held, that is named.
In every bin of frequency the power of the error is shared out in proportion to the powers of the parts and the
remainder: none is negative, and the sum is the mean square of the error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline
from scipy.signal import csd, welch

from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import DEVIATION_FRESH
from micromanip.settings.load import validate_document
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import AxisTracker, Tracker
from micromanip.settings.text.source import Source

from .bound import prediction_variance
from .budget import MEASURED, AxisBudget, Bound, ordered
from .causes import FORCE, PREDICTION, STAGE, TRACKER, Grid, shared_out
from .loop import AxisLaws
from .tracking import Tracking

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ACTUATOR, DISTURBANCE, MISSED, LIMITED, UNEXPLAINED = (
    "hysteresis left, creep, coupling, mismatch",
    "force, hysteresis left, creep, coupling",
    "missed cycles",
    "saturation",
    "not explained",
)
_SETTLED_S, _LEAST_S, _EDGE_S, _AFTER_S = 1.0, 3.0, 1.0, 0.02
"""Left out after tracking has begun; shortest stretch; left out at both ends of it, where filters know only one side;
how long a missed cycle or a limit is felt."""
_WINDOW_S, _FLOOR_SHARE, _STANDS_OUT, _ROOM = 1.0, 0.25, 10.0, 2.0
"""Of the samples' spectrum: its window; from which share of the sampling rate on it is floor; what stands out of it;
how far beyond that the path may go."""


@dataclass(frozen=True)
class Stretch:
    """Columns of one axis in consecutive cycles (n,), what was skipped filled with the row before it; um and s."""

    time_s: Array
    skipped: NDArray[np.bool_]
    limited: NDArray[np.bool_]
    taken_s: Array
    arrived_s: Array
    samples_um: Array
    stage_um: Array
    setpoint_um: Array
    true_stage_um: Array
    path_error_um: Array
    uncompensated_um: Array

    @property
    def late_s(self) -> float:
        """Age of a sample when it arrives."""
        return float(np.median(self.arrived_s - self.taken_s))

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Cycles (n,) away from both ends."""
        return np.asarray((self.time_s > _EDGE_S) & (self.time_s < self.time_s[-1] - _EDGE_S))

    @property
    def truth(self) -> bool:
        """Whether a simulation said where the stage really was."""
        return bool(np.isfinite(self.true_stage_um).all() and np.isfinite(self.path_error_um).all())


def recorded_budget(
    telemetry: Telemetry, axes: Sequence[str], coherence_s: float, say: Callable[[str], None]
) -> list[AxisBudget]:
    """The budget of each of `axes`. CheckFailed where the recording has no tracking, no tracker, or no model."""
    configuration = validate_document(Source.parse(telemetry.file, telemetry.configuration))
    if not isinstance(configuration.reference, Tracker):
        raise CheckFailed(f"{telemetry.file}: what ran followed no tracker (reference.source: signal): no path error")
    found = []
    for axis in axes:
        say(f"axis {axis}")
        stretch = _stretch(telemetry, configuration, axis)
        laws = AxisLaws(axis, configuration.axes[axis], configuration.reference.of(axis), telemetry.period_ns * 1e-9)
        found.append(_explained(stretch, laws, coherence_s))
    return found


def _stretch(telemetry: Telemetry, configuration: Configuration, axis: str) -> Stretch:
    """The longest time of tracking without another tuning, without its beginning."""
    cycle, state, version = (telemetry.column(name) for name in ("cycle", "state", "version"))
    tracking = np.flatnonzero(state == TRACKING)
    if not len(tracking):
        raise CheckFailed(f"{telemetry.file}: the cell does not track in it: there is no path error to budget")
    breaks = (np.diff(tracking) > 1) | (np.diff(version[tracking]) != 0)
    pieces = np.split(tracking, np.flatnonzero(breaks) + 1)
    longest = max(pieces, key=len)
    rate_hz = 1e9 / telemetry.period_ns
    first, last = int(cycle[longest[0]] + _SETTLED_S * rate_hz), int(cycle[longest[-1]])
    if (last - first) / rate_hz < _LEAST_S:
        raise CheckFailed(
            f"{telemetry.file}: it tracks for {(last - cycle[longest[0]]) / rate_hz:.2g} s at a stretch; a budget "
            f"needs {_SETTLED_S + _LEAST_S:g} s"
        )
    wanted = np.arange(first, last + 1)
    rows = np.searchsorted(cycle, wanted, side="right") - 1
    place = telemetry.axes.index(axis)

    def column(name: str) -> Array:
        return np.asarray(telemetry.column(f"axis.{place}.{name}"), dtype=float)

    time_ns = telemetry.column("time_ns").astype(float)
    time_s = (time_ns - time_ns[rows[0]]) * 1e-9
    fresh = (telemetry.column(f"axis.{place}.fresh").astype(int) & DEVIATION_FRESH) != 0
    fresh &= (np.arange(len(cycle)) >= rows[0]) & (np.arange(len(cycle)) <= rows[-1])
    age_s = column("deviation_age_ns") * 1e-9
    settings, voltage, setpoint = configuration.axes[axis], column("voltage_V"), column("setpoint_um")
    (low_V, high_V), (low_um, high_um) = configuration.outputs[f"voltage_{axis}"].range_V, settings.setpoint.range_um
    limited = (voltage <= low_V) | (voltage >= high_V) | (setpoint <= low_um) | (setpoint >= high_um)
    if np.count_nonzero(fresh) < 2:
        raise CheckFailed(f"{telemetry.file}: axis {axis}: no samples of deviation_{axis} came while it tracked")
    return Stretch(
        (wanted - wanted[0]) / rate_hz,
        np.isin(wanted, cycle, invert=True),
        limited[rows],
        (time_s - age_s)[fresh],
        time_s[fresh],
        column("deviation_um")[fresh],
        column("stage_um")[rows],
        setpoint[rows],
        column("true_stage_um")[rows],
        column("path_error_um")[rows],
        column("uncompensated_um")[rows],
    )


def predicted_share(telemetry: Telemetry, axis: str, tracker: AxisTracker) -> float:
    """Rms (um) of what noise, delay and prediction of the samples would have left of the path, with another `tracker`.

    Raises CheckFailed as `recorded_budget`.
    """
    configuration = validate_document(Source.parse(telemetry.file, telemetry.configuration))
    laws = AxisLaws(axis, configuration.axes[axis], tracker, telemetry.period_ns * 1e-9)
    stretch = _stretch(telemetry, configuration, axis)
    followed = _followed(stretch, laws)
    left = (followed.parts[TRACKER] + followed.parts[PREDICTION])[stretch.inside]
    return float(np.sqrt(np.mean(left**2)))


@dataclass(frozen=True)
class _Followed:
    """How the path (n,), um, was followed through `tracking` and the loop, `noise` (k,) being the samples' own."""

    path: Array
    noise: Array
    tracking: Tracking
    filters: Filters
    parts: dict[str, Array]


def _followed(stretch: Stretch, laws: AxisLaws) -> _Followed:
    time_s = stretch.time_s
    step_s = float(np.median(np.diff(stretch.taken_s)))
    truth = stretch.path_error_um + stretch.true_stage_um
    path = truth if stretch.truth else smoothed(stretch.taken_s, stretch.samples_um, time_s)
    clean = np.interp(stretch.taken_s, time_s, path)
    noise = stretch.samples_um - clean
    tracking = Tracking(laws.tracker, max(1, round(step_s / laws.period_s)), stretch.late_s, laws.period_s)
    seen = [
        tracking.given(stretch.taken_s, stretch.arrived_s, samples, time_s, laws.gains.reference)
        for samples in (clean, noise)
    ]
    filters = Filters.of(laws, len(time_s))
    parts = {
        TRACKER: -filters.through("followed", seen[1]),
        PREDICTION: path - filters.through("followed", seen[0]),
    }
    return _Followed(path, noise, tracking, filters, parts)


def _explained(stretch: Stretch, laws: AxisLaws, coherence_s: float) -> AxisBudget:
    truth, inside = stretch.truth, stretch.inside
    followed = _followed(stretch, laws)
    path, noise, tracking, filters = followed.path, followed.noise, followed.tracking, followed.filters
    stage = stretch.true_stage_um if truth else stretch.stage_um
    error = path - stage
    moved = stage - filters.through("plant", stretch.setpoint_um - laws.axis.centre_um)
    parts = dict(followed.parts)
    if truth and np.isfinite(stretch.uncompensated_um).all():
        pushed = _answering(moved, path - stretch.uncompensated_um, laws.period_s)
        parts[FORCE] = -filters.through("sensitivity", pushed)
        parts[ACTUATOR] = -filters.through("sensitivity", moved - pushed)
    else:
        parts[DISTURBANCE] = -filters.through("sensitivity", moved)
    if truth:
        parts[STAGE] = -filters.through("of_stage_noise", stretch.stage_um - stage)
    rest = error - np.sum(list(parts.values()), axis=0)
    missed, limited = _felt(stretch.skipped, laws.period_s), _felt(stretch.limited, laws.period_s)
    parts[MISSED] = np.where(missed, rest, 0.0)
    parts[LIMITED] = np.where(limited & ~missed, rest, 0.0)
    parts[UNEXPLAINED] = np.where(missed | limited, 0.0, rest)
    grid = Grid(1.0 / laws.period_s)
    alone = {name: binned(part[inside], grid) for name, part in parts.items()}
    outer = laws.axis.outer
    assert outer is not None
    if not truth:
        loop = laws.around(laws.model(grid.omega), grid.omega)
        alone[STAGE] = np.minimum(alone[DISTURBANCE], grid.white(loop.sensitivity, outer.sensor_noise_um**2))
        alone[DISTURBANCE] = alone[DISTURBANCE] - alone[STAGE]
    bound = _bound(path[inside], moved[inside], float(np.var(noise)), tracking, laws, coherence_s, known_stage=truth)
    known = "the simulation's own signals" if truth else "the smoothed tracker and the measured stage"
    return AxisBudget(
        laws.name,
        grid.hertz,
        ordered(shared_out(binned(error[inside], grid), alone), MEASURED),
        bound=bound,
        notes=(f"{inside.sum() * laws.period_s:.1f} s of tracking, by {known}",),
    )


def _bound(
    path: Array,
    moved: Array,
    noise_um2: float,
    tracking: Tracking,
    laws: AxisLaws,
    coherence_s: float,
    *,
    known_stage: bool,
) -> Bound:
    """The bound for the spectra of path and disturbance as they were recorded."""
    outer, period_s, grid = laws.axis.outer, laws.period_s, Grid(1.0 / laws.period_s)
    assert outer is not None
    noise, dead_s = outer.sensor_noise_um**2, outer.model.delay_cycles * period_s
    spectra = [binned((x - x.mean()) * np.hanning(len(x)) * np.sqrt(8.0 / 3.0), grid) for x in (path, moved)]
    if not known_stage:
        spectra[1] = np.maximum(spectra[1] - noise / len(grid.hertz), 0.0)
    ahead = np.asarray(tracking.latency_s + dead_s + period_s * np.arange(tracking.every))
    return Bound(
        prediction_variance(grid.hertz, spectra[0], coherence_s, noise_um2, tracking.every * period_s, ahead),
        prediction_variance(grid.hertz, spectra[1], coherence_s, noise, period_s, np.array([dead_s])),
        coherence_s,
    )


def _answering(moved: Array, copy: Array, period_s: float) -> Array:
    """What of `moved` (n,) answers to the force, which moves a `copy` (n,) that nobody controls.

    By the transfer between them (cross spectrum over spectrum): here the strain loop holds against it.
    """
    window = min(len(copy), round(_WINDOW_S / period_s))
    hertz, own = welch(copy, 1.0 / period_s, nperseg=window)
    _, both = csd(copy, moved, 1.0 / period_s, nperseg=window)
    transfer = np.divide(both, own, where=own > 0.0, out=np.zeros_like(both))
    padded, first = _mirrored(copy)
    lines = np.fft.rfftfreq(len(padded), period_s)
    spectrum = np.fft.rfft(padded) * np.interp(lines, hertz, transfer)
    return np.asarray(np.fft.irfft(spectrum, len(padded))[first : first + len(copy)])


def _felt(when: NDArray[np.bool_], period_s: float) -> NDArray[np.bool_]:
    """Cycles (n,) at, and shortly after, those marked."""
    count = np.cumsum(when)
    before = np.concatenate([np.zeros(1), count])[np.maximum(np.arange(len(when)) - round(_AFTER_S / period_s), 0)]
    return np.asarray(count > before)


def binned(x: Array, grid: Grid) -> Array:
    """Power of `x` (n,) in the bins of `grid`: their sum is its mean square (Parseval)."""
    lines = np.abs(np.fft.rfft(x)) ** 2 / len(x) ** 2
    lines[1 : len(lines) - (len(x) % 2 == 0)] *= 2.0
    return grid.lines(np.asarray(np.fft.rfftfreq(len(x), 1.0 / grid.rate_hz)), np.asarray(lines))


def smoothed(taken_s: Array, samples_um: Array, time_s: Array) -> Array:
    """The path (n,) at `time_s` by samples (k,) of before and after: all up to where their spectrum stands out."""
    step_s = float(np.median(np.diff(taken_s)))
    even = np.arange(taken_s[0], taken_s[-1] + 0.5 * step_s, step_s)
    samples = np.interp(even, taken_s, samples_um)
    hertz, density = welch(samples, 1.0 / step_s, nperseg=min(len(samples), round(_WINDOW_S / step_s)))
    floor = float(np.median(density[hertz > _FLOOR_SHARE / step_s]))
    highest = float(hertz[density > _STANDS_OUT * floor].max(initial=hertz[1]))
    padded, first = _mirrored(samples)
    share = 1.0 / (1.0 + (np.fft.rfftfreq(len(padded), step_s) / (_ROOM * highest)) ** 16)
    path = np.fft.irfft(np.fft.rfft(padded) * share, len(padded))[first : first + len(even)]
    return np.asarray(CubicSpline(even, path)(np.clip(time_s, even[0], even[-1])))


def _mirrored(x: Array) -> tuple[Array, int]:
    """`x` (n,) continued by its own point reflection to about twice its length, and where it begins in it."""
    more = next_fast_len(2 * len(x) - 2, real=True) - len(x)
    before, after = more // 2, more - more // 2
    padded = np.concatenate([2 * x[0] - x[before:0:-1], x, 2 * x[-1] - x[-2 : -after - 2 : -1]])
    return padded, before


@dataclass(frozen=True)
class Filters:
    """The closed loop around the configured model at the frequencies of a padded record."""

    responses: dict[str, Complex]

    @classmethod
    def of(cls, laws: AxisLaws, samples: int) -> Filters:
        """For signals of `samples` cycles."""
        padded = len(_mirrored(np.zeros(samples))[0])
        omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(padded, laws.period_s))
        omega[0] = 1e-3 * omega[1]  # at rest the PID has no finite gain, and a real system is what it is just above
        loop = laws.around(laws.model(omega), omega)
        names = ("plant", "followed", "sensitivity", "of_stage_noise")
        return cls({name: getattr(loop, name) for name in names})

    def through(self, name: str, x: Array) -> Array:
        """`x` (n,) behind one of the transfers."""
        padded, first = _mirrored(x)
        return np.asarray(np.fft.irfft(np.fft.rfft(padded) * self.responses[name], len(padded))[first : first + len(x)])
