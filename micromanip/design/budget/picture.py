"""The budget as a picture: variances as a bar, and in which bands of frequency they lie."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from micromanip.design.canvas import panels, save

from .budget import AxisBudget

_FRACTION = 6
"""Bands an octave."""


def draw_budget(budget: AxisBudget, folder: Path, about: str = "") -> Iterator[Path]:
    """Write the picture of one axis into `folder`, as PNG and SVG; the files."""
    powers = {f"{cause.name}: {cause.rms_um:.3f} um": cause.power for cause in budget.told_apart()}
    edges = np.concatenate([[0.0], 2.0 ** (np.arange(-_FRACTION, 13 * _FRACTION) / _FRACTION)])
    edges = np.append(edges[edges < budget.hertz[-1]], np.inf)
    middles = np.sqrt(np.maximum(edges[:-1], 0.4) * np.minimum(edges[1:], budget.hertz[-1]))
    known = "known: " if budget.unknown else ""
    figure, (bar, bands) = panels(2, f"Path error of axis {budget.axis}: {known}{budget.rms_um:.3f} um rms", 1.5)
    left, below = 0.0, np.zeros(len(middles))
    for k, (label, power) in enumerate(powers.items()):
        colour = f"C{k}"
        bar.barh(0.0, power.sum(), left=left, color=colour, label=label)
        left += float(power.sum())
        inside = np.histogram(budget.hertz, edges, weights=power)[0]
        bands.bar(middles, inside, width=0.11 * middles, bottom=below, color=colour)
        below += inside
    bar.set(xlabel="variance, um^2", ylim=(-0.6, 0.6), yticks=[])
    if budget.bound is not None:
        bar.axvline(budget.bound.rms_um**2, color="k", linestyle=":", label=f"bound: {budget.bound.rms_um:.3f} um")
    bar.legend(loc="upper center", bbox_to_anchor=(0.5, -0.25), ncols=2, fontsize="small", frameon=False)
    bands.set(xscale="log", xlabel="frequency, Hz", ylabel="um^2 per 1/6 octave")
    yield save(figure, folder, f"budget_{budget.axis}", about=about)
