"""Whether the outer loops follow the tooth's frequency: decided by trials of the cell as it will run.

At the speed that the spindle has while it is commissioned following can only cost. So the trial is played once more
with a frequency that is wrong by what an operator or a load brings about, fixed and followed. Who follows must be
better there, and no worse where the frequency is right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from micromanip.settings.schema.model import Configuration

from ..experiment import with_axis
from .production import Production

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
