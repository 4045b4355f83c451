"""The picture of a measured loop: its sensitivity over frequency, and its Nyquist curve near -1."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from .canvas import panels
from .running import Running

_FAR = 2.5
"""The Nyquist curve is shown so far from the origin."""


def picture(found: Running) -> Figure:
    """|S| at the measured lines with its confidence, and L around -1; predictions beside them where there are any."""
    lines = found.loop
    figure, (upper, lower) = panels(2, f"Axis {found.axis}, {lines.name}: measured while it runs", 1.9)
    near = np.abs(1.0 + lines.measured)
    band = (1.0 / (near + 2.0 * lines.deviation), 1.0 / np.maximum(near - 2.0 * lines.deviation, 0.05))
    upper.fill_between(lines.frequency_Hz, *band, color="tab:blue", alpha=0.25, lw=0, label="two standard deviations")
    upper.plot(lines.frequency_Hz, 1.0 / near, ".", color="tab:blue", label="measured")
    lower.plot(lines.measured.real, lines.measured.imag, ".", color="tab:blue", label="measured")
    if found.predicted is not None:
        hertz = np.geomspace(lines.frequency_Hz[0], lines.frequency_Hz[-1], 2000)
        L = lines.model(2 * np.pi * hertz)
        upper.plot(hertz, 1.0 / np.abs(1.0 + L), color="tab:orange", lw=1.2, label="predicted")
        lower.plot(L.real, L.imag, color="tab:orange", lw=1.2, label="predicted")
    highest = max(found.measured[found.nominal].sensitivity, 1.0)
    upper.set(xscale="log", yscale="log", xlabel="frequency, Hz", ylabel="|S|", ylim=(0.02, 2.0 * highest))
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    lower.plot(-1.0 + np.cos(angle) / highest, np.sin(angle) / highest, ":", color="grey", label=f"Ms {highest:.2f}")
    lower.plot([-1.0], [0.0], "+", color="black")
    lower.set(xlim=(-_FAR, _FAR), ylim=(-_FAR, 1.0), xlabel="Re L", ylabel="Im L")
    lower.set_aspect("equal")
    for panel in (upper, lower):
        panel.grid(alpha=0.3)
        panel.legend(fontsize="small")
    return figure
