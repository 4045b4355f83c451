"""All axes of a cell, one after the other; then the paper's experiment with the new tuning, and the verdicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from micromanip.settings.schema.model import Configuration

from ..analysis import AxisAnalysis, analyse_axis
from ..experiment import Experiment
from .axis import DRAWN, Commissioned, Knobs, Watched, commission_axis
from .evidence import Evidence
from .partial import Stopped
from .story import evidence
from .tracking import follow


def _say(say: Callable[[str], None], axis: str, what: str) -> None:
    say(f"axis {axis}: {what}")


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

    @property
    def passed(self) -> bool:
        """Whether every criterion of every axis holds, and none was stopped."""
        return self.stopped is None and all(each.passed for each in self.evidence)


def commission_cell(
    configuration: Configuration,
    experiment: Experiment,
    axes: Sequence[str],
    say: Callable[[str], None],
    knobs: Knobs | None = None,
    seed: int = 1,
) -> CommissionedCell:
    """Commission `axes` of `configuration`; the other axes keep what they have, and rest meanwhile."""
    watched, stopped = Watched(experiment), None
    found: list[Commissioned] = []
    for name in axes:
        try:
            found.append(commission_axis(configuration, watched, name, partial(_say, say, name), knobs, seed))
        except Stopped as problem:
            stopped = problem
            break
        configuration = found[-1].configuration
    stories, analyses, names = [], [], list(configuration.axes)
    for each in found:
        say(f"axis {each.axis}: acceptance")
        runs = follow(configuration, watched, each.axis)
        say(f"axis {each.axis}: analysis")
        analysis = analyse_axis(configuration, each.axis, watched, DRAWN, jobs=1, actuator=each.actuator)
        analyses.append(analysis)
        stories.append(evidence(each, analysis, runs, names.index(each.axis)))
    if stopped is not None:
        stories.append(stopped.evidence)
    return CommissionedCell(configuration, tuple(found), tuple(analyses), tuple(stories), stopped)
