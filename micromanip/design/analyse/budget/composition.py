"""What the path error of an axis is made of, for a report: causes, bound, other sensors, and a plot over frequency."""

from __future__ import annotations

import numpy as np

from ...report.model import Curve, Plot, Section, Table
from .budget import AxisBudget, percent

TITLE = "What the path error is made of"


def composition(budget: AxisBudget) -> Section:
    """Causes, bound and other sensors as tables, and the variance summed up over frequency as a plot."""
    told = budget.document()
    causes = tuple(
        (each["name"], f"{each['rms_um']:.3f} um", percent(each["share_percent"]), each["how"])
        for each in told["causes"]
    )
    share = percent(budget.share_percent(budget.variance_um2))
    rows = (*causes, (budget.sum_name, f"{budget.rms_um:.3f} um", share, ""))
    tables = [Table(f"Path error of axis {budget.axis} by cause", ("Cause", "rms", "Share", "How"), rows)]
    if budget.variants:
        others = tuple((each.what, f"{each.rms_um:.3f} um") for each in budget.variants)
        named = ("With", f"{budget.sum_name.capitalize()}, rms")
        tables.append(Table(f"Axis {budget.axis}: what it would be", named, others))
    text = " ".join(
        [
            "Variances of causes that know nothing of each other add up (docs/analyse.md).",
            *(f"{note[0].upper()}{note[1:]}." for note in budget.notes),
            *(f"Not known: {each}." for each in budget.unknown),
        ]
    )
    return Section(TITLE, text, _bound(budget), (summed_up(budget),), tuple(tables))


def _bound(budget: AxisBudget) -> dict[str, str]:
    bound = budget.bound
    if bound is None:
        return {}
    figures = {
        f"causal bound, phases known for {bound.coherence_s:g} s": f"{bound.rms_um:.3f} um",
        "the path's share of the bound": f"{np.sqrt(bound.path_um2):.3f} um",
        "the force's share of it": f"{np.sqrt(bound.force_um2):.3f} um",
    }
    if bound.rms_um > 0.0:
        figures["this one leaves"] = f"{budget.rms_um / bound.rms_um:.1f} times that"
    return figures


def summed_up(budget: AxisBudget) -> Plot:
    """Variance below each frequency: a line is a step, noise a slope."""
    hertz = budget.hertz
    shown = budget.told_apart()
    curves = [Curve(budget.sum_name, hertz, np.cumsum(np.sum([cause.power for cause in budget.causes], axis=0)))]
    curves += [Curve(cause.name, hertz, np.cumsum(cause.power)) for cause in shown]
    if budget.bound is not None:
        ends = hertz[[0, -1]]
        curves.append(Curve("bound", ends, np.full(2, budget.bound.rms_um**2)))
    return Plot(
        "Variance of the path error below a frequency",
        "frequency, Hz",
        "um^2",
        tuple(curves),
        "A sine is a step, noise a slope; where the whole rises is where there is something to gain.",
        log_x=True,
    )
