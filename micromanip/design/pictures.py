"""Pictures of what `analyse` finds: an error budget, a path, a running loop, the health of an axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from micromanip.settings.schema.accept import Accept
from micromanip.settings.schema.axis import Axis

from .budget.budget import AxisBudget
from .canvas import panels, save
from .drift.history import COLUMNS, LABELS, MARGINS, Check
from .drift.judged import DRAWN, Judged
from .preview.preview import AxisPreview
from .preview.stretches import ERROR
from .running import Running

_MOST = 20_000
"""Points a line: more are not seen, and make large files."""


def draw_preview(axis: AxisPreview, left: AxisPreview, settings: Axis, folder: Path, about: str = "") -> Iterator[Path]:
    """Write the picture of one axis, with and without the robot's offset, into `folder`; the files."""
    verdict = "fits" if not axis.stretches else f"asks {len(axis.stretches)} times for more than there is"
    figure, (path, setpoint, error) = panels(3, f"Preview of axis {axis.axis}: {verdict}", 1.7)
    time_s = np.arange(len(axis.predicted.setpoint_um)) / axis.predicted.rate_Hz
    shown = slice(None, None, max(1, len(time_s) // _MOST))
    for found, label, width in ((axis.predicted, "as it is", 1.2), (left.predicted, "with the robot's offset", 0.8)):
        path.plot(time_s[shown], found.deviation_um[shown], lw=width, label=label)
        setpoint.plot(time_s[shown], found.setpoint_um[shown], lw=width)
        error.plot(time_s[shown], found.error_um[shown], lw=width)
    for limit in settings.setpoint.range_um:
        setpoint.axhline(limit, color="k", linestyle=":")
    for sign in (-1.0, 1.0):
        error.axhline(sign * axis.tolerance_um, color="k", linestyle=":")
    for stretch in axis.stretches:
        panel = error if stretch.what == ERROR else setpoint
        panel.axvspan(stretch.from_s, stretch.to_s, color="tab:red", alpha=0.2, lw=0)
    path.set(ylabel="deviation, um")
    path.legend(fontsize="small", frameon=False)
    setpoint.set(ylabel="set-point, um")
    error.set(ylabel="following error, um", xlabel="s of the path")
    yield save(figure, folder, f"preview_{axis.axis}", about=about)


def health_picture(checks: Sequence[Check], judged: Judged, accept: Accept) -> Figure:
    """`checks` of one axis under one tuning, oldest first."""
    shown = [name for name in COLUMNS if not all(np.isnan(check.figures[name]) for check in checks)]
    figure, axes = panels(len(shown), f"Axis {judged.axis}: {judged.checks} checks", 0.35 * len(shown))
    found = {each.name: each for each in judged.watched}
    least = dict(zip(MARGINS, (accept.gain_margin_dB, accept.phase_margin_deg), strict=True))
    time = [check.time for check in checks]
    for panel, name in zip(axes, shown, strict=True):
        panel.plot(time, [check.figures[name] for check in checks], "o-", ms=3, lw=0.8, color="tab:blue")
        panel.set_ylabel(LABELS[name], fontsize="small")
        panel.grid(alpha=0.3)
        panel.label_outer()
        if name in least:
            panel.axhline(least[name], color="tab:red", lw=1, ls="--")
            continue
        if not np.isnan(found[name].commissioned):
            panel.axhline(found[name].commissioned, color="tab:orange", lw=1, label="model")
            if name in DRAWN:
                for share in DRAWN[name]:
                    panel.axhline(found[name].commissioned * share, color="tab:red", lw=1, ls="--")
        if (since := found[name].since) is not None:
            panel.axvline(since, color="tab:red", lw=1)
            panel.set_title(f"drifts since {since:%Y-%m-%d %H:%M}", fontsize="small", color="tab:red", loc="right")
    figure.autofmt_xdate()
    return figure


_FRACTION = 6
"""Bands an octave."""


def draw_budget(budget: AxisBudget, folder: Path, about: str = "") -> Iterator[Path]:
    """Write the picture of one axis into `folder`; the files."""
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


_FAR = 2.5
"""The Nyquist curve is shown so far from the origin."""


def loop_picture(found: Running) -> Figure:
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
