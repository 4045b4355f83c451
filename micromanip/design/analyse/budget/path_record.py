"""How a recorded path was followed: the path, the samples' noise, and what tracking left of both.

What a simulation knows is taken as it is: path and stage. Else the path is the tracker's, smoothed without lag: a low
pass H of zero phase, beyond what stands out of the floor of the samples' spectrum. It passes the noise n of that band
too, so the error seen has (H - T) n where the true one has -T n, T being the way from the samples to the stage; with
the noise's density, which the samples above that band show, the difference is known in power (`mistaken`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline
from scipy.signal import welch

from micromanip.control.system import Array, Complex
from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.replay.window import recorded_configuration
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import DEVIATION_FRESH
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import AxisTracker, Tracker
from micromanip.virtual.experiment import at_limit

from .budget import BIN_HZ, PREDICTION, TRACKER, Grid
from .loop import AxisLaws, Loop
from .tracking import Tracking

WINDOW_S = 1.0
"""Of the spectra of recorded signals."""
BEGUN_S, _LEAST_S, _EDGE_S = 2.0, 4.0, 1.0
"""Left out after tracking has begun; the shortest stretch; left out at its end, where filters know only one side."""
_FLOOR_SHARE, _STANDS_OUT, _ROOM, _NOTHING = 0.25, 10.0, 2.0, 0.01
"""Of the samples' spectrum: from which share of the sampling rate on it is floor; what stands out of it; how far beyond
that the path may go; what of the samples is nothing in it."""


_COLUMNS = (
    *("deviation_age_ns", "voltage_V", "setpoint_um", "deviation_um", "stage_um"),
    *("true_stage_um", "path_error_um", "uncompensated_um"),
)


@dataclass(frozen=True)
class Stretch:
    """Columns of one axis in consecutive cycles (n,), what was skipped filled with the row before it; um and s.

    Samples are those from before, too, and figures are taken from `begun_s` on: the predictor remembers for seconds.
    """

    begun_s: float
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
        """Cycles (n,) that figures are taken of, away from both ends."""
        return np.asarray((self.time_s > self.begun_s) & (self.time_s < self.time_s[-1] - _EDGE_S))

    @property
    def truth(self) -> bool:
        """Whether a simulation said where the stage really was."""
        return bool(np.isfinite(self.true_stage_um).all() and np.isfinite(self.path_error_um).all())


def tracking_stretch(
    telemetry: Telemetry, configuration: Configuration, axis: str, begun_s: float = BEGUN_S
) -> Stretch:
    """The longest time of tracking without another tuning, of which figures are taken `begun_s` after its beginning.

    Raises CheckFailed where it is too short, or no tracker's samples came in it.
    """
    cycle, state, version = telemetry.columns("cycle", "state", "version").values()
    tracking = np.flatnonzero(state == TRACKING)
    if not len(tracking):
        raise CheckFailed(f"{telemetry.file}: the cell does not track in it: there is no path error to budget")
    breaks = (np.diff(tracking) > 1) | (np.diff(version[tracking]) != 0)
    pieces = np.split(tracking, np.flatnonzero(breaks) + 1)
    longest = max(pieces, key=len)
    rate_hz = 1e9 / telemetry.period_ns
    first, last = int(cycle[longest[0]]), int(cycle[longest[-1]])
    if (last + 1 - first) / rate_hz < _LEAST_S:
        raise CheckFailed(
            f"{telemetry.file}: it tracks for {(last - first) / rate_hz:.2g} s at a stretch; a budget needs "
            f"{_LEAST_S:g} s"
        )
    wanted = np.arange(first, last + 1)
    rows = np.searchsorted(cycle, wanted, side="right") - 1
    place = telemetry.axes.index(axis)
    columns = telemetry.columns("time_ns", *(f"axis.{place}.{name}" for name in ("fresh", *_COLUMNS)))

    def column(name: str) -> Array:
        return np.asarray(columns[f"axis.{place}.{name}"], dtype=float)

    time_ns = columns["time_ns"].astype(float)
    time_s = (time_ns - time_ns[rows[0]]) * 1e-9
    fresh = (columns[f"axis.{place}.fresh"].astype(int) & DEVIATION_FRESH) != 0
    fresh[rows[-1] + 1 :] = False
    age_s = column("deviation_age_ns") * 1e-9
    setpoint = column("setpoint_um")
    limited = at_limit(configuration, axis, column("voltage_V"), setpoint)
    if np.count_nonzero(fresh[rows[0] :]) < 2:
        raise CheckFailed(f"{telemetry.file}: axis {axis}: no samples of deviation_{axis} came while it tracked")
    return Stretch(
        begun_s,
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


@dataclass(frozen=True)
class Followed:
    """How the path (n,), um, was followed through `tracking` and the loop, `noise` (k,) being the samples' own.

    `parts` (n,), um, are what the noise, and delay and prediction, made of the error; `smoothing` is how the path was
    got of the samples, None where it is the truth.
    """

    path: Array
    smoothing: Smoothed | None
    noise_um: float
    tracking: Tracking
    filters: Filters
    parts: dict[str, Array]


def follow(stretch: Stretch, laws: AxisLaws) -> Followed:
    """What `laws` make of the samples of `stretch`, whatever laws ran when it was recorded."""
    time_s = stretch.time_s
    step_s = float(np.median(np.diff(stretch.taken_s)))
    truth = stretch.path_error_um + stretch.true_stage_um
    own = stretch.taken_s >= 0.0
    smoothing = None if stretch.truth else smoothed(stretch.taken_s[own], stretch.samples_um[own], time_s)
    path = truth if smoothing is None else smoothing.path
    # those from before have no path beside them: they tell the predictor what the loop's knew
    clean = np.where(own, np.interp(stretch.taken_s, time_s, path), stretch.samples_um)
    noise = (stretch.samples_um - clean)[own]
    tracking = Tracking(laws.tracker, max(1, round(step_s / laws.period_s)), stretch.late_s, laws.period_s)
    times, row = (stretch.taken_s, stretch.arrived_s), laws.gains.reference
    # which predictor is believed is told by the noise
    given, trust = tracking.stepped(*times, stretch.samples_um, time_s, row)
    of_path, _ = tracking.stepped(*times, clean, time_s, row, trust)
    filters = Filters.of(laws, len(time_s))
    parts = {
        TRACKER: -filters.through("followed", given - of_path),
        PREDICTION: path - filters.through("followed", of_path),
    }
    noise_um = float(np.std(noise)) if smoothing is None else smoothing.noise_um
    return Followed(path, smoothing, noise_um, tracking, filters, parts)


def followed_share(loop: Loop, tracking: Tracking, taken: Array) -> Complex:
    """What the stage does (n,) of a sine of the deviation of amplitude 1, at the frequencies of `loop`."""
    late = np.exp(-1j * loop.omega * tracking.latency_s)
    return np.asarray(loop.followed * tracking.response(taken, loop.omega) * late / tracking.every)


class Mistaken(NamedTuple):
    """Power (n,), um^2, by which smoothing makes a part look smaller than it is: of the noise, the rest, and both."""

    tracker: Array
    prediction: Array
    whole: Array


def mistaken(followed: Followed, laws: AxisLaws, grid: Grid) -> Mistaken:
    """What the noise in a smoothed path makes of the error and its parts; nothing where the path is the truth."""
    if followed.smoothing is None:
        nothing = np.zeros(len(grid.hertz))
        return Mistaken(nothing, nothing, nothing)
    loop = laws.around(laws.model(grid.omega), grid.omega)
    to_stage = followed_share(loop, followed.tracking, laws.gains.reference)
    passed = followed.smoothing.share(grid.hertz)
    passed = np.where(passed > _NOTHING, passed, 0.0)
    highest_Hz = 0.5 / (followed.tracking.every * laws.period_s)
    white = np.where(grid.hertz < highest_Hz, followed.noise_um**2 * BIN_HZ / highest_Hz, 0.0)
    true = np.abs(to_stage) ** 2
    return Mistaken(
        white * true * (1.0 - (1.0 - passed) ** 2),
        -white * np.abs((1.0 - to_stage) * passed) ** 2,
        white * (true - np.abs(passed - to_stage) ** 2),
    )


def predicted_shares(telemetry: Telemetry, axis: str, found: AxisTracker) -> dict[str, Any]:
    """Rms (um) of what noise, delay and prediction of the samples would have left of the path, or why that isn't told.

    With the tracker as it ran and as it was `found`.
    """
    _, configuration = recorded_configuration(telemetry)
    if not isinstance(configuration.reference, Tracker):
        return {"before_um": None, "after_um": None, "reason": "what ran followed no tracker"}

    def left_um(tracker: AxisTracker) -> float:
        laws = AxisLaws(axis, configuration.axes[axis], tracker, telemetry.period_ns * 1e-9)
        stretch = tracking_stretch(telemetry, configuration, axis)
        followed = follow(stretch, laws)
        left = (followed.parts[TRACKER] + followed.parts[PREDICTION])[stretch.inside]
        unseen = mistaken(followed, laws, Grid(1.0 / laws.period_s)).whole
        return float(np.sqrt(max(0.0, np.mean(left**2) + unseen.sum())))

    try:
        before, after = map(left_um, (configuration.reference.of(axis), found))
    except CheckFailed as problem:
        return {"before_um": None, "after_um": None, "reason": str(problem)}
    return {"before_um": before, "after_um": after, "reason": None}


@dataclass(frozen=True)
class Smoothed:
    """A `path` (n,), um, of samples low-passed at `highest_Hz`; `noise_um` is the sigma of their noise, if white."""

    path: Array
    highest_Hz: float
    noise_um: float

    def share(self, hertz: Array) -> Array:
        """What (n,) of the samples at `hertz` (n,) is in the path."""
        return _passed(hertz, self.highest_Hz)


def _passed(hertz: Array, highest_Hz: float) -> Array:
    return np.asarray(1.0 / (1.0 + (hertz / highest_Hz) ** 16))


def smoothed(taken_s: Array, samples_um: Array, time_s: Array) -> Smoothed:
    """The path (n,) at `time_s` by samples (k,) of before and after: all up to where their spectrum stands out."""
    step_s = float(np.median(np.diff(taken_s)))
    even = np.arange(taken_s[0], taken_s[-1] + 0.5 * step_s, step_s)
    samples = np.interp(even, taken_s, samples_um)
    hertz, density = welch(samples, 1.0 / step_s, nperseg=min(len(samples), round(WINDOW_S / step_s)))
    floor = float(np.median(density[hertz > _FLOOR_SHARE / step_s]))
    highest_Hz = _ROOM * float(hertz[density > _STANDS_OUT * floor].max(initial=hertz[1]))
    padded, first = mirrored(samples)
    passed = _passed(np.asarray(np.fft.rfftfreq(len(padded), step_s)), highest_Hz)
    path = np.fft.irfft(np.fft.rfft(padded) * passed, len(padded))[first : first + len(even)]
    noise_um = np.sqrt(np.var(samples - path) / np.mean((1.0 - passed) ** 2))
    at_cycles = np.asarray(CubicSpline(even, path)(np.clip(time_s, even[0], even[-1])))
    return Smoothed(at_cycles, highest_Hz, float(noise_um))


def mirrored(x: Array) -> tuple[Array, int]:
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
        padded = len(mirrored(np.zeros(samples))[0])
        omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(padded, laws.period_s))
        omega[0] = 1e-3 * omega[1]  # at rest the PID has no finite gain, and a real system is what it is just above
        loop = laws.around(laws.model(omega), omega)
        names = ("plant", "followed", "sensitivity", "of_stage_noise")
        return cls({name: getattr(loop, name) for name in names})

    def through(self, name: str, x: Array) -> Array:
        """`x` (n,) behind one of the transfers."""
        padded, first = mirrored(x)
        return np.asarray(np.fft.irfft(np.fft.rfft(padded) * self.responses[name], len(padded))[first : first + len(x)])
