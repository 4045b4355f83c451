"""All axes of a cell, one after the other; then the paper's experiment with the new tuning, and the verdicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Jog

from ..analyse.axis import AxisAnalysis, analyse_axis
from ..experiment import Experiment, with_axis, with_reference
from ..report.model import Evidence
from .axis import Commissioned, commission_axis
from .closing import DRAWN, Options
from .coupled import Coupled, decoupled, look_at_coupling, with_coupling
from .guarded_experiment import GuardedExperiment, Stopped
from .production import Budgeted, Production, in_production, tried
from .quiescent_spectrum import AtRest, look_at_rest
from .report_sections import evidence
from .validation import follow

# At the speed that the spindle has while it is commissioned following can only cost. So the trial is played once more
# with a frequency that is wrong by what an operator or a load brings about, fixed and followed. Who follows must be
# better there, and no worse where the frequency is right.

RANGE_PERCENT = 3.0
"""Range that is tried: a spindle's slip under load, or another nominal speed of the same motor."""
_OFF_PERCENT = 0.25
_COSTS, _WORTH = 0.02, 0.05
"""What it may cost at the right frequency, what it must save at the wrong one: shares of the path error."""


def with_followed_tooth(production: Production, again: Callable[[Production], Production]) -> Production:
    """`production`, following the tooth in each axis where its trials, played by `again`, are better for it."""
    cancels = [name for name, axis in production.configuration.axes.items() if axis.outer and axis.outer.oscillation_Hz]
    if not cancels or not production.seen:
        return production
    right = again(_changed(production, cancels, RANGE_PERCENT, 0.0))
    wrong = [again(_changed(production, cancels, each, _OFF_PERCENT)) for each in (0.0, RANGE_PERCENT)]
    for trial in (right, *wrong):
        if trial.problem is not None:
            return _left_out(production, trial.problem)
    fixed, followed = wrong
    kept = [
        name
        for name in cancels
        if right.seen[name].rms <= (1.0 + _COSTS) * production.seen[name].rms
        and followed.seen[name].rms < (1.0 - _WORTH) * fixed.seen[name].rms
    ]
    figures = ", ".join(
        f"{name} {fixed.seen[name].rms:.3f} um fixed, {followed.seen[name].rms:.3f} followed (at the right one "
        f"{production.seen[name].rms:.3f} and {right.seen[name].rms:.3f})"
        for name in cancels
    )
    said = f"With its frequency wrong by {_OFF_PERCENT:g} % the tooth leaves, of axis {figures}."
    if not kept:
        return _told(production, f"{said} It is not followed.")
    settled = right if kept == cancels else again(_changed(production, kept, RANGE_PERCENT, 0.0))
    if settled.problem is not None:
        return _left_out(production, settled.problem)
    return _told(settled, f"{said} It is followed over +-{RANGE_PERCENT:g} %: axis {', '.join(kept)}.")


def _changed(production: Production, axes: list[str], range_percent: float, off_percent: float) -> Production:
    configuration: Configuration = production.configuration
    for name in axes:
        outer = configuration.axes[name].outer
        assert outer is not None
        assert outer.oscillation_Hz is not None
        said_Hz = outer.oscillation_Hz * (1.0 + 0.01 * off_percent)
        changed = outer.model_copy(update={"oscillation_Hz": said_Hz, "oscillation_range_percent": range_percent})
        configuration = with_axis(configuration, name, outer=changed)
    return replace(production, configuration=configuration)


def _left_out(production: Production, problem: str) -> Production:
    return _told(production, f"Following the tooth's frequency was tried and left out: {problem}.")


def _told(production: Production, sentence: str) -> Production:
    return replace(production, decided=(*production.decided, sentence))


_SHARES = (
    ("sensors at rest", 0.1), ("polarity and scale", 0.1), ("major loop", 0.5), ("answer to a step", 0.1),
    ("excitation", 2.3), ("hysteresis models", 4.3), ("actuator", 2.5), ("strain PID", 4.8),
    ("sensitivity of the strain loop", 1.2), ("tooth where it works", 0.8), ("stage dynamics", 2.8),
    ("outer loop", 16.0), ("sensitivity of the outer loop", 1.4), ("validation", 0.8),
)  # fmt: skip
_AFTERWARDS = (("acceptance", 3.0), ("analysis", 2.9))
"""Steps of an axis, and those of each when all are tuned, with the seconds that they took of one simulated axis."""
_COUPLING = "coupling of the axes"
"""The step of all axes together."""


def planned(axes: Sequence[str]) -> list[tuple[str, float]]:
    """What `commission_cell` says of these axes, in order, and how the time is shared out; some steps may not come."""
    tuned = [(_of(axis, name), share) for axis in axes for name, share in _SHARES]
    judged = [(_of(axis, name), share) for axis in axes for name, share in _AFTERWARDS]
    together = [(_COUPLING, 2.5)] if len(axes) > 1 else []
    return [("the cell at rest", 1.4), *tuned, *together, *judged, ("as it will run", 8.0), ("report", 1.0)]


def _of(axis: str, what: str) -> str:
    return f"axis {axis}: {what}"


@dataclass(frozen=True)
class CommissionedCell:
    """The new `configuration`, what was found, its analysis and the evidence, an entry per axis.

    Where an axis was `stopped`, those before it are whole, its own evidence comes last, and those after it were not
    begun.
    """

    configuration: Configuration
    axes: tuple[Commissioned, ...]
    analyses: tuple[AxisAnalysis, ...]
    evidence: tuple[Evidence, ...]
    stopped: Stopped | None = None
    rest: AtRest | None = None
    production: Production | None = None
    """How it goes to production; None where that was not asked for, or an axis was stopped."""
    coupled: Coupled | None = None
    """What the axes see of each other; None where not all of the cell, or only one, were commissioned."""
    stalled: str = ""
    """For how long this computer or a device stood still in an experiment, in a sentence; empty if never."""

    @property
    def passed(self) -> bool:
        """Whether every criterion of every axis holds, and none was stopped."""
        return self.stopped is None and all(each.passed for each in self.evidence)

    @property
    def proven(self) -> bool:
        """Whether the cell may run with it: no axis was stopped, and what is missed is accuracy alone."""
        return self.stopped is None and all(each.proven for each in self.evidence)

    def production_document(self) -> dict[str, Any] | None:
        """How it goes to production, as JSON; None where that was not asked for."""
        production, rest = self.production, self.rest
        if production is None or rest is None:
            return None
        reference = production.configuration.reference
        return {
            "tracks": production.tracks,
            "obstacle": production.obstacle,
            "decided": list(production.decided),
            "reference": reference.model_dump(mode="json", exclude_defaults=True) if production.tracks else None,
            "tooth_hz": {n: axis.outer and axis.outer.oscillation_Hz for n, axis in self.configuration.axes.items()},
            "tooth_seen_hz": rest.tooth_Hz,
            "path_error_um": {
                name: {"uncompensated_rms": seen.uncompensated_rms, "rms": seen.rms, "max": seen.max}
                | {"limited_percent": seen.limited_percent}
                for name, seen in production.seen.items()
            },
            "budget": {name: budget.document() for name, budget in production.budgets.items()},
            "budget_obstacle": production.unbudgeted,
        }


def commission_cell(
    configuration: Configuration,
    experiment: Experiment,
    axes: Sequence[str],
    say: Callable[[str], None],
    options: Options | None = None,
    seed: int = 1,
    running: Experiment | None = None,
    written: Callable[[Configuration], Configuration] = lambda it: it,
    budgeted: Budgeted | None = None,
) -> CommissionedCell:
    """Commission `axes` of `configuration`; the other axes keep what they have, and rest meanwhile.

    With `running`, an experiment in which the process goes on, the cell is looked at while it rests, and what was found
    is tried as it will run: `written` gives what a file of a configuration holds, `budgeted` what its error is made of.
    """
    watched, stopped, rest = GuardedExperiment(experiment), None, None
    acting = None if running is None else GuardedExperiment(running)
    options = options or Options()
    if acting is not None:
        say("the cell at rest")
        rest = _at_rest(configuration, acting)
        options = replace(options, tooth_seen_Hz=rest.tooth_Hz)
    found: list[Commissioned] = []
    for name in axes:
        try:
            told = lambda what, name=name: say(_of(name, what))  # noqa: E731
            found.append(commission_axis(configuration, watched, name, told, options, seed, acting))
        except Stopped as problem:
            stopped = problem
            break
        configuration = found[-1].configuration
        options = replace(options, tooth_seen_Hz=options.tooth_seen_Hz or found[-1].tooth_Hz)
    configuration = within_reach(configuration)
    stories, analyses, names, coupled = [], [], list(configuration.axes), None
    if stopped is None and len(found) == len(names) > 1 and all(each.outer for each in found):
        say(_COUPLING)
        coupled = look_at_coupling(configuration, watched, seed)
        configuration = coupled.noted(configuration)
    for each in found:
        say(_of(each.axis, "acceptance"))
        runs = follow(configuration, watched, each.axis)
        say(_of(each.axis, "analysis"))
        known = each.outer.stage.found.unsure_at if each.outer else np.zeros_like
        analysis = analyse_axis(configuration, each.axis, watched, DRAWN, jobs=1, actuator=each.actuator, unsure=known)
        analyses.append(analysis)
        story = evidence(each, analysis, runs, names.index(each.axis))
        judged = () if coupled is None else (coupled.criterion(each.axis),)
        stories.append(replace(story, criteria=(*story.criteria, *judged)))
    production = None
    if stopped is not None:
        stories.append(stopped.evidence)
    elif running is not None and rest is not None:
        missed = sum(not (each.passed or each.acceptance) for story in stories for each in story.criteria)
        production = in_production(configuration, rest, missed)
        if production.tracks:
            say("as it will run")
            trial = partial(tried, written=written, experiment=running, budgeted=budgeted)
            production = trial(production)
            if coupled is not None:
                production, coupled = decoupled(production, coupled, trial)
            production = with_followed_tooth(production, trial)
            configuration = production.configuration
        stories = [_with_production(story, production, rest) for story in stories]
    if coupled is not None:
        stories = [with_coupling(story, coupled) for story in stories]
    return CommissionedCell(
        configuration, tuple(found), tuple(analyses), tuple(stories), stopped, rest, production, coupled,
        watched.ever_stalled,
    )  # fmt: skip


def within_reach(configuration: Configuration) -> Configuration:
    """A reference set by hand in volts, for an untuned axis, is one in um once the axis is tuned: where it works."""
    reference, strain = configuration.reference, [a for a in configuration.axes.values() if a.mode == "strain"]
    if not isinstance(reference, Jog) or not strain:
        return configuration
    low, high = max(a.setpoint.range_um[0] for a in strain), min(a.setpoint.range_um[1] for a in strain)
    if low <= reference.range_um[0] and reference.range_um[1] <= high:
        return configuration
    offset_um = min(max(strain[0].centre_um, low), high)
    return with_reference(
        configuration, reference.model_copy(update={"offset_um": offset_um, "range_um": (low, high), "target_um": {}})
    )


def _at_rest(configuration: Configuration, experiment: Experiment) -> AtRest:
    """What is seen at rest; nothing, where a fault ends it: the axis' first step says which, and keeps a report."""
    try:
        return look_at_rest(configuration, experiment)
    except CheckFailed:
        return AtRest(None, 0.0, None, None)


def _with_production(story: Evidence, production: Production, rest: AtRest) -> Evidence:
    judged = (production.criterion(story.axis, rest.tracker_noise_um),) if production.tracks else ()
    sections = (*production.sections(story.axis), *story.sections)
    return replace(story, criteria=(*story.criteria, *judged), sections=sections)
