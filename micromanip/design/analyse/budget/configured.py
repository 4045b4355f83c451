"""The budget of a configuration: computed from its models, completed by a short run in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from micromanip.bus.simulated_axis import SimulatedAxis
from micromanip.errors import CheckFailed
from micromanip.settings.check import Prepared
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker
from micromanip.settings.wiring.timing import AT_ONCE, cycles_between, feedback_path, signal_timing
from micromanip.virtual.altered import NOISE, Played, play_as_it_is, play_without

from .budget import MEASURED, AxisBudget, Bound, Cause, Variant, ordered, prediction_variance
from .causes import (
    BIN_HZ,
    COUPLING,
    CREEP,
    MISFIT,
    PREDICTION,
    STAGE,
    TRACKER,
    Grid,
    Powers,
    simulated_powers,
    tracker_noise,
)
from .loop import AxisLaws
from .tracking import Tracking

Array = NDArray[np.float64]
HYSTERESIS, SATURATION = "hysteresis left", "saturation"
_COARSE_HZ = 4.0
"""Bins for sums alone: the rest of a midpoint rule over such smooth spectra is small beside 1 %."""
_BORNE = 1.6
"""Noise over what is stated up to which a narrow predictor is believed: with more, six stated sigma are soon met."""
_OF_PATH = (PREDICTION, MISFIT, CREEP, COUPLING)
_UNKNOWN = "deviation of the robot, force, noise of the gauge, hysteresis left: "
_UNTOLD = f"{_UNKNOWN}the driver that simulates the cell does not tell them; a recording shows what they make together"
_REAL = f"{_UNKNOWN}a configuration of a real cell does not hold them; a recording shows them"


@dataclass(frozen=True)
class Cell:
    """What a budget is made of: laws and tracking of each axis, and what a simulation knows."""

    laws: AxisLaws
    tracking: Tracking
    known: SimulatedAxis | None

    def powers(self, bin_hz: float = BIN_HZ) -> tuple[Grid, Powers]:
        """Causes that a linear model shows, in bins of `bin_hz`."""
        grid = Grid(1.0 / self.laws.period_s, bin_hz)
        if self.known is not None:
            return grid, simulated_powers(grid, self.laws, self.tracking, self.known)
        outer = self.laws.axis.outer
        assert outer is not None
        loop = self.laws.around(self.laws.model(grid.omega), grid.omega)
        noise = tracker_noise(grid, loop, self.tracking, self.laws.gains.reference, self.laws.tracker.noise_um)
        return grid, {TRACKER: noise, STAGE: grid.white(loop.of_stage_noise, outer.sensor_noise_um**2)}

    def rms_um(self) -> float:
        """Root of the sum of those causes."""
        return float(np.sqrt(sum(power.sum() for power in self.powers(_COARSE_HZ)[1].values())))


def cell_of(prepared: Prepared, axis: str) -> Cell:
    """Laws, tracking and simulation of `axis`. Raises CheckFailed where a budget of it can't be made."""
    configuration, wiring = prepared.configuration, prepared.wiring
    tracker = configuration.reference
    if not isinstance(tracker, Tracker):
        raise CheckFailed(
            f"{prepared.source.path}: a budget is of the error of a path that a tracker sees: reference.source is "
            f"{tracker.source}, it must be signal"
        )
    if tracker.frame is not None:
        raise CheckFailed(
            f"{prepared.source.path}: reference.frame: a budget is made of trackers that read the axes themselves"
        )
    path = feedback_path(configuration, wiring, axis)
    if path != AT_ONCE:
        raise CheckFailed(
            f"{prepared.source.path}: axis {axis} is behind a bus: a budget is made of cells whose sensors are read, "
            "and whose voltages are written, in every cycle"
        )
    timing = signal_timing(configuration, wiring, f"deviation_{axis}")
    driver = wiring.drivers[configuration.outputs[f"voltage_{axis}"].driver]
    simulated = getattr(driver, "simulated_axis", None)  # a driver of a bus has none
    known = None if simulated is None else _decoupled(configuration, simulated, axis)
    settings = configuration.axes[axis]
    if known is not None and settings.outer is not None:
        settings = settings.model_copy(update={"outer": settings.outer.at_tooth(known.tooth[0])})
    told = tracker.of(axis)
    if known is not None and known.tracker_noise_um > _BORNE * told.noise_um:
        told = replace(told, steady=None)
    known_Hz = () if known is None else (hertz for hertz, um in known.deviation if um > 0.0)
    laws = AxisLaws(axis, settings, told.at_swings(known_Hz), configuration.loop.period_ns * 1e-9)
    tracking = Tracking(laws.tracker, cycles_between(configuration, timing), timing.latency_s, laws.period_s)
    return Cell(laws, tracking, known)


def _decoupled(configuration: Configuration, simulated: Callable[[str], SimulatedAxis], axis: str) -> SimulatedAxis:
    """The simulated `axis` with what its decoupling leaves of the others' motion; they stand in their order."""
    known, section = simulated(axis), configuration.axes[axis].coupling
    if section is None or not section.decouple:
        return known
    taken = [
        section.share.get(other, 0.0) * um
        for other in configuration.axes
        if other != axis
        for _, um in simulated(other).deviation
    ]
    left = tuple((hertz, seen - um) for (hertz, seen), um in zip(known.neighbours, taken, strict=True))
    return replace(known, neighbours=left)


def budget_of(
    prepared: Prepared,
    axes: Sequence[str],
    seconds: float,
    seed: int,
    coherence_s: float,
    say: Callable[[str], None],
) -> list[AxisBudget]:
    """The budget of each of `axes`; a simulated cell is also played for `seconds`, 0: not at all.

    Where its driver tells nothing of its plant, only its path error comes of that.
    """
    cells = {axis: cell_of(prepared, axis) for axis in axes}
    whole = quiet = None
    if seconds > 0.0 and all(cell.known is not None for cell in cells.values()):
        say("playing the cell")
        whole = play_without(prepared, (), seconds, seed)
        say("playing it without noise and force")
        quiet = play_without(prepared, NOISE, seconds, seed, whole)
    elif seconds > 0.0 and prepared.wiring.virtual:
        say("playing the cell")
        whole = play_as_it_is(prepared, seconds)
    found = []
    for axis, cell in cells.items():
        say(f"axis {axis}: causes")
        grid, powers = cell.powers()
        causes, measured = list(ordered(powers)), None
        if whole is not None:
            place = list(prepared.configuration.axes).index(axis)
            if f"path_error_{axis}" in prepared.configuration.signals:  # else it is of samples, their noise included
                measured = float(np.sqrt(whole.variance_um2[place]))
            if quiet is not None:
                causes += _measured(grid, powers, whole, quiet, place)
        budget = AxisBudget(
            axis,
            grid.hertz,
            tuple(sorted(causes, key=lambda cause: -cause.variance_um2)),
            measured_um=measured,
            unknown=() if cell.known is not None else (_REAL if prepared.wiring.real else _UNTOLD,),
        )
        say(f"axis {axis}: bound and other sensors")
        bound = None if cell.known is None else bound_of(cell, cell.known, coherence_s)
        rest = budget.variance_um2 - sum(float(power.sum()) for power in powers.values())
        found.append(replace(budget, bound=bound, variants=tuple(_variants(cell, rest))))
    return found


def _measured(grid: Grid, powers: Powers, whole: Played, quiet: Played, place: int) -> list[Cause]:
    """What no linear model shows, from virtual time: hysteresis left, and what a limit that held has cost."""
    expected = sum(float(powers[name].sum()) for name in _OF_PATH)
    left = max(0.0, float(quiet.variance_um2[place]) - expected)
    limited = whole.limited[:, place]
    squares = whole.error_um[:, place] ** 2
    cost = 0.0
    if limited.any() and not limited.all():
        cost = max(0.0, float(limited.mean() * (squares[limited].mean() - squares[~limited].mean())))
    at = np.zeros(1)
    return [
        Cause(name, grid.lines(at, np.array([power])), MEASURED)
        for name, power in ((HYSTERESIS, left), (SATURATION, cost))
    ]


def bound_of(cell: Cell, known: SimulatedAxis, coherence_s: float) -> Bound:
    """The bound for path and force of a simulated axis; the dead time is that of the model of the stage."""
    tracking, laws = cell.tracking, cell.laws
    period_s, outer = laws.period_s, laws.axis.outer
    assert outer is not None
    dead_s = outer.model.delay_cycles * period_s
    hertz, amplitude = np.array(known.deviation).T
    path = prediction_variance(
        hertz,
        0.5 * amplitude**2,
        coherence_s,
        known.tracker_noise_um**2,
        tracking.every * period_s,
        np.asarray(tracking.latency_s + dead_s + period_s * np.arange(tracking.every)),
    )
    grid = Grid(1.0 / period_s)
    coarse = grid.omega[::4]
    _, to_stage = laws.simulated(known.plant, coarse)
    rms_N, bandwidth_Hz = known.force_noise
    kept = np.exp(-period_s * 2.0 * np.pi * bandwidth_Hz)
    shape = np.abs(to_stage / (1.0 - kept * np.exp(-1j * coarse * period_s))) ** 2
    noise = shape * rms_N**2 * (1.0 - kept * kept) / len(coarse)
    tooth_Hz, tooth_N = known.tooth
    _, at_tooth = laws.simulated(known.plant, np.array([2.0 * np.pi * tooth_Hz]))
    force = prediction_variance(
        np.append(coarse / (2.0 * np.pi), tooth_Hz),
        np.append(noise, 0.5 * (tooth_N * abs(at_tooth[0])) ** 2),
        coherence_s,
        known.stage_noise_um**2,
        period_s,
        np.array([dead_s]),
    )
    return Bound(path, force, coherence_s)


def _variants(cell: Cell, rest_um2: float) -> list[Variant]:
    """The whole with other sensors; filters are made for them, as they would be. `rest_um2` stays."""
    found = []

    def add(what: str, other: Cell) -> None:
        found.append(Variant(what, float(np.sqrt(other.rms_um() ** 2 + max(rest_um2, 0.0)))))

    tracking, laws, known = cell.tracking, cell.laws, cell.known
    for factor in (0.2, 0.4, 2.0, 4.0):
        tracker = replace(laws.tracker, noise_um=factor * laws.tracker.noise_um)
        quieter = None if known is None else replace(known, tracker_noise_um=factor * known.tracker_noise_um)
        other = Cell(replace(laws, tracker=tracker), replace(tracking, tracker=tracker), quieter)
        add(f"tracker noise {tracker.noise_um:.3g} um", other)
    for every in (2 * tracking.every, max(1, tracking.every // 2)):
        rate_hz = 1.0 / (every * tracking.period_s)
        tracker = replace(laws.tracker, sample_rate_Hz=rate_hz)
        if every != tracking.every:
            other = Cell(replace(laws, tracker=tracker), replace(tracking, tracker=tracker, every=every), known)
            add(f"tracker rate {rate_hz:g} Hz", other)
    for factor in (0.5, 2.0, 4.0):
        latency_s = factor * tracking.latency_s
        if latency_s > 0.0:
            add(
                f"tracker latency {1e3 * latency_s:g} ms",
                replace(cell, tracking=replace(tracking, latency_s=latency_s)),
            )
    outer = laws.axis.outer
    assert outer is not None
    for factor in (0.5, 4.0):
        noise_um = factor * outer.sensor_noise_um
        axis = laws.axis.model_copy(update={"outer": outer.model_copy(update={"sensor_noise_um": noise_um})})
        seen = None if known is None else replace(known, stage_noise_um=factor * known.stage_noise_um)
        add(
            f"capacitive sensor noise {1e3 * noise_um:.3g} nm", replace(cell, laws=replace(laws, axis=axis), known=seen)
        )
    if known is not None:
        for factor in (0.0, 0.5, 2.0):
            (noise_N, bandwidth_Hz), (tooth_Hz, tooth_N) = known.force_noise, known.tooth
            pushed = replace(known, force_noise=(factor * noise_N, bandwidth_Hz), tooth=(tooth_Hz, factor * tooth_N))
            add(f"force {100 * factor:g} %", replace(cell, known=pushed))
        joint_Hz = max(known.deviation)[0]
        swinging = laws.tracker.oscillations
        if len(swinging) == 1 and f"{swinging[0].frequency_Hz:.4g}" != f"{joint_Hz:.4g}":
            right = swinging[0].model_copy(update={"frequency_Hz": joint_Hz})
            tracker = replace(laws.tracker, oscillations=(right,))
            other = Cell(replace(laws, tracker=tracker), replace(tracking, tracker=tracker), known)
            add(f"reference.oscillation_Hz {joint_Hz:.4g}", other)
    return found
