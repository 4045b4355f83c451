"""Commissioning the axes together: their coupling measured, said, and taken away ahead where that pays.

Decoupling is switched on for an axis only where a share is beyond its uncertainty and the path error of the trial is
expected to fall by ``WORTH``; and it stays on only where a second trial is not worse than the first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from micromanip.design.analyse.coupling import (
    Cost,
    Coupling,
    Together,
    costs,
    judge_together,
    loop_of,
    measure_coupling,
    relative_gain,
)
from micromanip.settings.schema.coupling import Coupling as CouplingSection
from micromanip.settings.schema.model import Configuration

from ..experiment import Experiment, with_axis
from ..report.model import Criterion, Curve, Evidence, Plot, Section, Table
from .production import MOVED_HZ, Production

WORTH = 0.01
"""Share of the path error that decoupling must be expected to take away."""
NOT_WORSE = 1.01
"""The second trial is another draw of noise on a real cell: so much more than the first is still the same."""
_SHOWN = 2.0
"""Standard deviations that are printed behind a +-."""


@dataclass(frozen=True)
class Coupled:
    """What was measured and judged; the `cost` of each axis where there was a trial, and what was `decided`."""

    coupling: Coupling
    together: Together
    cost: dict[str, Cost] = field(default_factory=dict)
    decoupled: tuple[str, ...] = ()
    decided: tuple[str, ...] = ()

    def noted(self, configuration: Configuration) -> Configuration:
        """`configuration` with what is beyond its uncertainty in each axis' section ``coupling``; nothing decoupled."""
        names, found = self.coupling.axes, self.coupling
        for i, name in enumerate(names):
            shares = {other: float(found.rest[i, j]) for j, other in enumerate(names) if found.sure[i, j]}
            configuration = with_axis(configuration, name, coupling=CouplingSection(share=shares) if shares else None)
        return configuration

    def criterion(self, axis: str) -> Criterion:
        """The outer loops as one, beside each alone."""
        one = self.together
        turned = "" if one.interaction < 1.0 else f", {abs(one.turns)} turns"
        value = f"interaction {one.interaction:.2f} at {one.interaction_Hz:.0f} Hz{turned}"
        return Criterion(axis, "outer loops together: stable", one.stable, value, "interaction below 1, or no turn")

    def rows(self) -> list[tuple[str, ...]]:
        """A row for each pair: who sees, who moves, at rest, at most, the gauge, and the relative gain at rest."""
        found, gains = self.coupling, relative_gain(self.coupling.rest).real
        rows: list[tuple[str, ...]] = []
        for i, axis in enumerate(found.axes):
            for j, other in enumerate(found.axes):
                if j == i:
                    continue
                most = int(np.argmax(found.sure_size[i, j]))
                at_most = f"{100 * np.abs(found.share[i, j, most]):.1f} % at {found.frequency_Hz[most]:.0f} Hz"
                sure = found.sure_size[i, j, most] > 0.0
                rows.append((
                    axis,
                    other,
                    _percent(found.rest[i, j], found.rest_deviation[i, j]) + ("" if found.sure[i, j] else ", not sure"),
                    at_most if sure else "not sure",
                    _percent(found.gauge[i, j], found.gauge_deviation[i, j]),
                    f"{gains[i, j]:+.4f}",
                ))  # fmt: skip
        return rows

    def document(self) -> dict[str, Any]:
        """As in JSON."""
        found, one = self.coupling, self.together
        size, hertz, sees, moves = found.largest
        return {
            "axes": list(found.axes),
            "rest": found.rest.tolist(),
            "rest_deviation": found.rest_deviation.tolist(),
            "gauge": found.gauge.tolist(),
            "gauge_deviation": found.gauge_deviation.tolist(),
            "relative_gain": relative_gain(found.rest).real.tolist(),
            "largest": {"share": size, "at_Hz": hertz, "sees": sees, "moves": moves},
            "frequency_Hz": found.frequency_Hz.tolist(),
            "share": np.abs(found.share).tolist(),
            "deviation": found.deviation.tolist(),
            "relative_gain_over_frequency": np.abs(relative_gain(found.share)).tolist(),
            "together": {
                "stable": one.stable,
                "interaction": one.interaction,
                "at_Hz": one.interaction_Hz,
                "turns": one.turns,
            },
            "cost_um": {axis: asdict(cost) for axis, cost in self.cost.items()},
            "decoupled": list(self.decoupled),
            "decided": list(self.decided),
        }


def look_at_coupling(configuration: Configuration, experiment: Experiment, seed: int) -> Coupled:
    """Measure the coupling of all axes of `configuration`, which are tuned, and judge their outer loops together."""
    coupling = measure_coupling(configuration, experiment, seed)
    late = {name: experiment.path(configuration, name).stage_late for name in coupling.axes}
    loops = np.array([loop_of(configuration, name, coupling.frequency_Hz, late[name]) for name in coupling.axes])
    return Coupled(coupling, judge_together(coupling.frequency_Hz, coupling.share, coupling.deviation, loops))


def decoupled(
    production: Production, coupled: Coupled, again: Callable[[Production], Production]
) -> tuple[Production, Coupled]:
    """What of both stays once the trial has been seen: decoupled where it pays, after a trial `again`."""
    motion = production.moved_um
    if motion is None or not production.seen:
        return production, replace(coupled, decided=("There was no trial: nothing is decoupled.",))
    coupled = replace(coupled, cost=costs(production.configuration, coupled.coupling, motion, MOVED_HZ))
    pays = [
        name
        for i, name in enumerate(coupled.coupling.axes)
        if coupled.coupling.sure[i].any()
        and coupled.cost[name].whole(production.seen[name].rms) < (1.0 - WORTH) * production.seen[name].rms
    ]
    if not pays:
        said = f"Decoupling would take less than {100 * WORTH:g} % of the path error away: it is off."
        return production, replace(coupled, decided=(said,))
    configuration = production.configuration
    for name in pays:
        section = configuration.axes[name].coupling
        assert section is not None
        configuration = with_axis(configuration, name, coupling=section.model_copy(update={"decouple": True}))
    tried = again(replace(production, configuration=configuration))
    worse = [name for name in pays if not _kept(production, tried, name)]
    if worse:
        why = tried.problem or _compared(production, tried, worse)
        said = f"Decoupling was tried and taken back: {why}."
        return production, replace(coupled, decided=(said,))
    said = f"Decoupled: {_compared(production, tried, pays)}."
    return tried, replace(coupled, decoupled=tuple(pays), decided=(said,))


def _kept(before: Production, after: Production, axis: str) -> bool:
    if after.problem is not None or axis not in after.seen:
        return False
    return after.seen[axis].rms <= NOT_WORSE * before.seen[axis].rms


def _compared(before: Production, after: Production, axes: list[str]) -> str:
    return ", ".join(f"{name} {before.seen[name].rms:.3f} to {after.seen[name].rms:.3f} um rms" for name in axes)


def with_coupling(story: Evidence, coupled: Coupled) -> Evidence:
    """The evidence of one axis with what it sees of the others."""
    return replace(story, sections=(*story.sections, _section(story.axis, coupled)))


def _section(axis: str, coupled: Coupled) -> Section:
    found, i = coupled.coupling, coupled.coupling.axes.index(axis)
    curves = []
    for j, other in enumerate(found.axes):
        if j != i:
            curves.append(Curve(f"of {other}", found.frequency_Hz, np.abs(found.share[i, j])))
            curves.append(Curve(f"of {other}, deviation", found.frequency_Hz, found.deviation[i, j], faint=True))
    rows = [row[1:] for row in coupled.rows() if row[0] == axis]
    gains = relative_gain(found.share)[i, i]
    far = int(np.argmax(np.abs(gains - 1.0)))
    figures = {
        "relative gain at rest": f"{relative_gain(found.rest).real[i, i]:.4f}",
        "relative gain farthest from 1": f"{np.abs(gains[far]):.2f} at {found.frequency_Hz[far]:.0f} Hz",
    }
    if axis in coupled.cost:
        cost = coupled.cost[axis]
        figures |= {
            "the others move this stage, at rest": f"by up to {cost.moved:.2f} um",
            "path error of ignoring it": f"{cost.ignored:.3f} um rms",
            "decoupling would leave": f"{cost.decoupled:.3f} um rms, and {cost.unsure:.3f} um that is not sure",
        }
    heads = ("Moves", "This stage, at rest", "at most, over frequency", "This gauge, at rest", "Relative gain at rest")
    text = "Each axis was moved with all strain loops closed, and every sensor looked at. " + " ".join(coupled.decided)
    plot = Plot(
        f"What stage {axis} sees of the others",
        "frequency, Hz",
        "um per um",
        tuple(curves),
        "Level: geometry. A peak at this axis' own mode: the flexure pushes.",
        log_x=True,
        log_y=True,
    )
    table = Table(f"Coupling into axis {axis}, +- {_SHOWN:g} standard deviations", heads, tuple(rows))
    return Section("Coupling", text, figures, (plot,), (table,))


def _percent(share: float, deviation: float) -> str:
    return f"{100 * share:+.3f} +- {100 * _SHOWN * deviation:.3f} %"
