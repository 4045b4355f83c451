"""The budget of a run: what its recorded signals show of each cause, carried through the laws that ran.

With the path d, the samples' noise n, and what disturbs the stage, ``v = y - G u`` (u the recorded set-point, G the
model of the stage), the loop's equations (``loop.py``) are an identity of recorded signals:

    e = d - y = (d - T d~) - T n~ - S v + G Y S m

d~ and n~ are path and noise behind the predictor, T its way to the stage, S the sensitivity, m the capacitive sensor's
noise. Path and stage are those of ``path_record.py``; of a simulation the motion of a copy that nobody controls shows
the force. Else the sensor's noise is told from the rest by its configured size.

What these parts do not explain is left as a remainder: where cycles were missing or a limit held, that is named.
In every bin of frequency the power of the error is shared out in proportion to the powers of the parts and the
remainder: none is negative, and the sum is the mean square of the error, less what smoothing makes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd, welch

from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.replay.window import recorded_configuration
from micromanip.settings.check import Prepared
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker
from micromanip.virtual.experiment import VirtualExperiment

from .budget import FORCE, PREDICTION, STAGE, TRACKER, AxisBudget, Bound, Grid, prediction_variance, shared_out
from .loop import AxisLaws
from .path_record import BEGUN_S, WINDOW_S, Stretch, follow, mirrored, mistaken, tracking_stretch
from .tracking import Tracking

ACTUATOR, DISTURBANCE, MISSED, LIMITED, UNEXPLAINED = (
    "hysteresis left, creep, coupling, mismatch",
    "force, hysteresis left, creep, coupling",
    "missed cycles",
    "saturation",
    "not explained",
)
_AFTER_S, _ENTERED_S = 0.02, 4.0
"""How long a missed cycle or a limit is felt; after which the tool of a simulated cell is in."""


def recorded_budget(
    telemetry: Telemetry, axes: Sequence[str], coherence_s: float, say: Callable[[str], None]
) -> list[AxisBudget]:
    """The budget of each of `axes`. CheckFailed where the recording has no tracking, no tracker, or no model."""
    _, configuration = recorded_configuration(telemetry)
    return _budgets(telemetry, configuration, axes, coherence_s, say)


def played_budget(
    prepared: Prepared, axes: Sequence[str], seconds: float, coherence_s: float, say: Callable[[str], None]
) -> list[AxisBudget]:
    """The same of `seconds` in virtual time, machining included. CheckFailed where a cell is not simulated."""
    file, configuration = prepared.source.path, prepared.configuration
    if not prepared.wiring.virtual:
        raise CheckFailed(f"{file}: only a simulated cell is played; take a recording of a real one")
    for axis in axes:  # refused before it is played
        _laws(file, configuration, axis)
    say("playing the cell")
    rows = VirtualExperiment(prepared, process=True)(configuration, _ENTERED_S + seconds, prepared.samples)
    return budget_of_rows(file, configuration, rows, axes, coherence_s, say, _ENTERED_S)


def budget_of_rows(
    file: Path,
    configuration: Configuration,
    rows: NDArray[Any],
    axes: Sequence[str] = (),
    coherence_s: float = 1.0,
    say: Callable[[str], None] = lambda _: None,
    begun_s: float = BEGUN_S,
) -> list[AxisBudget]:
    """The budget of `axes` (none: all) in the rows that `configuration`, which `file` holds, left."""
    _, own = np.unique(rows["cycle"], return_index=True)  # a skipped cycle's row is a copy of the one before
    names = list(configuration.axes)
    telemetry = Telemetry.of_rows(file, names, configuration.loop.period_ns, rows[own], "")
    return _budgets(telemetry, configuration, axes or names, coherence_s, say, begun_s)


def _budgets(
    telemetry: Telemetry,
    configuration: Configuration,
    axes: Sequence[str],
    coherence_s: float,
    say: Callable[[str], None],
    begun_s: float = BEGUN_S,
) -> list[AxisBudget]:
    found = []
    for axis in axes:
        say(f"axis {axis}")
        laws = _laws(telemetry.file, configuration, axis)
        found.append(_explained(tracking_stretch(telemetry, configuration, axis, begun_s), laws, coherence_s))
    return found


def _laws(file: Path, configuration: Configuration, axis: str) -> AxisLaws:
    if not isinstance(configuration.reference, Tracker):
        raise CheckFailed(f"{file}: what ran followed no tracker (reference.source: signal): no path error")
    tracker = configuration.reference.of(axis)
    return AxisLaws(axis, configuration.axes[axis], tracker, configuration.loop.period_ns * 1e-9)


def _explained(stretch: Stretch, laws: AxisLaws, coherence_s: float) -> AxisBudget:
    truth, inside = stretch.truth, stretch.inside
    followed = follow(stretch, laws)
    path, tracking, filters = followed.path, followed.tracking, followed.filters
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
    alone = {name: grid.binned(part[inside]) for name, part in parts.items()}
    outer = laws.axis.outer
    assert outer is not None
    if not truth:
        loop = laws.around(laws.model(grid.omega), grid.omega)
        alone[STAGE] = np.minimum(alone[DISTURBANCE], grid.white(loop.sensitivity, outer.sensor_noise_um**2))
        alone[DISTURBANCE] = alone[DISTURBANCE] - alone[STAGE]
    unseen = mistaken(followed, laws, grid)
    alone[TRACKER] += unseen.tracker
    alone[PREDICTION] = _with(alone[PREDICTION], unseen.prediction)
    whole = _with(grid.binned(error[inside]), unseen.whole)
    bound = _bound(path[inside], moved[inside], followed.noise_um**2, tracking, laws, coherence_s, known_stage=truth)
    # the spectra of a short run scatter; what it left is possible
    share = min(1.0, float(whole.sum()) / max(bound.path_um2 + bound.force_um2, 1e-12))
    bound = Bound(share * bound.path_um2, share * bound.force_um2, coherence_s)
    known = "the simulation's own signals" if truth else "the smoothed tracker and the measured stage"
    return AxisBudget(
        laws.name,
        grid.hertz,
        shared_out(whole, alone),
        bound,
        f"{inside.sum() * laws.period_s:.1f} s of tracking, by {known}",
    )


def _with(power: Array, unseen: Array) -> Array:
    """`power` (n,) with what of it is `unseen` (n,), in proportion: the bins of one record scatter about their mean."""
    where = unseen != 0.0
    seen = float(power[where].sum())
    factor = 1.0 if seen <= 0.0 else max(0.0, 1.0 + float(unseen[where].sum()) / seen)
    return np.where(where, factor * power, power)


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
    spectra = [grid.binned((x - x.mean()) * np.hanning(len(x)) * np.sqrt(8.0 / 3.0)) for x in (path, moved)]
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
    window = min(len(copy), round(WINDOW_S / period_s))
    hertz, own = welch(copy, 1.0 / period_s, nperseg=window)
    _, both = csd(copy, moved, 1.0 / period_s, nperseg=window)
    transfer = np.divide(both, own, where=own > 0.0, out=np.zeros_like(both))
    padded, first = mirrored(copy)
    lines = np.fft.rfftfreq(len(padded), period_s)
    spectrum = np.fft.rfft(padded) * np.interp(lines, hertz, transfer)
    return np.asarray(np.fft.irfft(spectrum, len(padded))[first : first + len(copy)])


def _felt(when: NDArray[np.bool_], period_s: float) -> NDArray[np.bool_]:
    """Cycles (n,) at, and shortly after, those marked."""
    count = np.cumsum(when)
    before = np.concatenate([np.zeros(1), count])[np.maximum(np.arange(len(when)) - round(_AFTER_S / period_s), 0)]
    return np.asarray(count > before)
