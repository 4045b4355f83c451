"""The end of commissioning: a configuration that tracks, tried as it will run, or a sentence why there is none.

Every axis follows the tracker with its stage; the process goes on meanwhile, where the simulation has one, and on a
real cell as it does at that time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import Array
from micromanip.errors import MicromanipError
from micromanip.settings.checks.ranges import range_warnings
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker
from micromanip.virtual.experiment import at_limit

from ..analyse.budget.budget import TITLE, AxisBudget, composition
from ..experiment import Experiment, with_axes, with_reference
from ..report.model import Criterion, Curve, Plot, Section
from ..validate.criteria import told
from .predictor import known_deviations
from .quiescent_spectrum import AtRest

Budgeted = Callable[[Configuration, NDArray[Any]], list[AxisBudget]]
"""Error budgets of a configuration whose rows of a trial are given; MicromanipError where none can be made."""

TRACKED_S = 9.0
_FADED_IN_S = 1.0
MOVED_HZ = 1000.0
_SHARE, _NOISES = 0.05, 2.0
"""Of the uncompensated error, and of the tracker's noise: the path error that is asked for by default."""


@dataclass(frozen=True)
class PathErrorSeen:
    """Figures of one axis in um over the time tracked, and what is `left` (n,) over the time (s).

    `limited_percent` of the time set-point or voltage was at an end of its range, and nothing was corrected.
    """

    uncompensated_rms: float
    rms: float
    max: float
    t_s: Array
    left: Array
    limited_percent: float = 0.0

    @property
    def limited(self) -> str:
        """What is said of it beside the figures; nothing, where it did not come to that."""
        return f", at an end of its range {self.limited_percent:.2g} % of the time" if self.limited_percent else ""


@dataclass(frozen=True)
class Production:
    """`configuration` as it goes to production; `obstacle` says why it does not track, None where it does.

    `decided` are sentences on what was chosen, `seen` the path errors by axis, `problem` what ended the trial,
    `budgets` what those errors are made of, `unbudgeted` why that isn't told.
    """

    configuration: Configuration
    obstacle: str | None = None
    decided: tuple[str, ...] = ()
    seen: dict[str, PathErrorSeen] = field(default_factory=dict)
    problem: str | None = None
    known: bool = True
    budgets: dict[str, AxisBudget] = field(default_factory=dict)
    unbudgeted: str | None = None
    moved_um: Array | None = field(default=None, repr=False, compare=False)
    """Stage positions (n, axes) of the trial, at ``MOVED_HZ``; None where there was none."""

    @property
    def tracks(self) -> bool:
        """Whether the configuration follows the tracker."""
        return self.obstacle is None

    def criterion(self, axis: str, noise_um: float) -> Criterion:
        """The trial of one axis; `noise_um` is that of the tracker."""
        name = "path error as it will run"
        if self.problem is not None or axis not in self.seen:
            return Criterion(
                axis, name, False, self.problem or "not seen", "the cell comes to TRACKING and stays there"
            )
        seen, accept = self.seen[axis], self.configuration.axes[axis].accept
        limit = accept.tracking_error_um or float(np.hypot(_SHARE * seen.uncompensated_rms, _NOISES * noise_um))
        value = f"{told(seen.rms, limit, 3)} um rms, {seen.max:.1f} um at most{seen.limited}"
        wanted = (
            f"<= {limit:.3g} um rms, following the tracker for {TRACKED_S - _FADED_IN_S:g} s; "
            f"uncompensated {seen.uncompensated_rms:.0f} um"
        )
        return Criterion(axis, name, seen.rms <= limit, value, wanted, acceptance=True)

    def sections(self, axis: str) -> tuple[Section, ...]:
        """What is told of it in the report."""
        if axis in self.budgets:
            return self._trial(axis), composition(self.budgets[axis])
        if self.unbudgeted is not None:
            return self._trial(axis), Section(TITLE, f"That is not told: {self.unbudgeted}.")
        return (self._trial(axis),)

    def _trial(self, axis: str) -> Section:
        if self.obstacle is not None:
            return Section("In production", f"The tuned file does not track: {self.obstacle}.")
        text = "The tuned file, as it is written, armed and tracking, all axes together. " + " ".join(self.decided)
        if axis not in self.seen:
            return Section("In production", f"{text} It was ended: {self.problem}")
        seen = self.seen[axis]
        figures = {
            "path error": f"{seen.rms:.3f} um rms, {seen.max:.2f} um at most{seen.limited}",
            "uncompensated": f"{seen.uncompensated_rms:.1f} um rms",
            "told by": "the simulation's truth"
            if self.known
            else "the tracker's reference less the stage, its noise included",
        }
        plot = Plot("Path error as it will run", "time, s", "um", (Curve("left", seen.t_s, seen.left),))
        return Section("In production", text, figures, (plot,))


def obstacle(configuration: Configuration) -> str | None:
    """Why this cell can't track; None where it can."""
    names = list(configuration.axes)
    if configuration.frame is None:
        missing = [f"deviation_{name}" for name in names if f"deviation_{name}" not in configuration.signals]
        if missing:
            return f"it has no signal {', '.join(missing)}: name the tracker's channels in signals"
    untuned = [name for name, axis in configuration.axes.items() if axis.outer is None]
    if untuned:
        return f"axis {', '.join(untuned)} has no outer loop: commission it from the tuned file, or all at once"
    return None


def in_production(configuration: Configuration, rest: AtRest, missed: int = 0) -> Production:
    """`configuration` in mode stage on all axes, following the tracker; one that the user described stays as it is.

    With `missed` criteria it is not, and so is not tried: nobody wants such loops to follow a robot.
    """
    reason = obstacle(configuration) or (f"{missed} criteria are not met" if missed else None)
    if reason is not None:
        return Production(configuration, reason)
    decided, reference = [_tooth(configuration, rest)], configuration.reference
    if isinstance(reference, Tracker):
        decided.append("The reference is the one of the configuration.")
    else:
        reference = rest.reference()
        axes, said = known_deviations(reference, rest)
        reference = reference.model_copy(update={"axes": axes})
        joints = (
            "its joints were not seen to oscillate"
            if rest.joints_Hz is None
            else f"its joints oscillate at {reference.oscillation_Hz:g} Hz"
        )
        decided.append(
            f"The reference is the tracker as it was seen at rest: {reference.sample_rate_Hz:g} samples a second, "
            f"noise {reference.noise_um:g} um; of the robot, {joints}."
        )
        decided += said
    tracking = with_reference(with_axes(configuration, mode="stage"), reference)
    decided += [f"{told[0].upper()}{told[1:]}." for _, told in range_warnings(tracking)]
    return Production(tracking, decided=tuple(decided))


def _tooth(configuration: Configuration, rest: AtRest) -> str:
    cancelled = sorted({axis.outer.oscillation_Hz or 0.0 for axis in configuration.axes.values() if axis.outer})
    if cancelled == [0.0]:
        return (
            "No tooth frequency is cancelled: none was given (--tooth-frequency), and the stage shows no line, neither "
            "parked nor where it works; with the spindle cutting air it may."
        )
    seen = f", at rest {rest.tooth_um:.2f} um at {rest.tooth_Hz:g} Hz were seen" if rest.tooth_Hz else ""
    return f"Cancelled is the tooth's frequency, {' and '.join(f'{hertz:g}' for hertz in cancelled)} Hz{seen}."


def tried(
    production: Production,
    written: Callable[[Configuration], Configuration],
    experiment: Experiment,
    budgeted: Budgeted | None = None,
) -> Production:
    """The path errors, and their budgets, of what `written` gives back of the configuration: what its file holds."""
    try:
        configuration = written(production.configuration)
        rows = experiment(configuration, TRACKED_S)
    except MicromanipError as problem:
        return replace(production, problem=str(problem))
    every = configuration.loop.rate_hz
    settled = rows["axis"][round(_FADED_IN_S * every) :]
    seen = {}
    for i, name in enumerate(configuration.axes):
        own = settled[:, i]
        error, moved = (np.asarray(own[f], dtype=float) for f in ("path_error_um", "uncompensated_um"))
        if not np.isfinite(error).all():
            return replace(production, problem=f"axis {name}: its path error is not known at all times")
        t_s = np.arange(len(error)) / every
        limited = 100.0 * float(np.mean(at_limit(configuration, name, own["voltage_V"], own["setpoint_um"])))
        seen[name] = PathErrorSeen(_rms(moved), _rms(error), float(np.abs(error).max()), t_s, error, limited)
    known = all(f"path_error_{name}" in configuration.signals for name in configuration.axes)
    moved_um = np.asarray(settled["stage_um"][:: max(1, round(every / MOVED_HZ)), : len(seen)], dtype=float)
    production = replace(production, configuration=configuration, seen=seen, known=known, moved_um=moved_um)
    if budgeted is None:
        return production
    try:
        return replace(production, budgets={each.axis: each for each in budgeted(configuration, rows)})
    except MicromanipError as problem:
        return replace(production, unbudgeted=str(problem))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
