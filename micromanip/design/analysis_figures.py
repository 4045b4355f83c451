"""Pictures of an analysis: describing function (figure 7), its map, Bode, Nyquist with the Ms circle, drawn plants."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import NDArray

from micromanip.settings.schema.accept import Accept

from .analysis import AxisAnalysis
from .canvas import panels, save
from .judged import Inverse
from .loops import Margins, Sample, System, grid, refined

Array = NDArray[np.float64]

_COLOURS = {"strain loop": "tab:blue", "outer loop": "tab:orange"}
_AT_WORST = "tab:cyan"
_SHOWN_HZ, _FAR = 1.0, 20.0
"""Bode plots begin there; an Ms above the other is drawn there."""


def describing_function(inverse: Inverse) -> Figure:
    """Figure 7: offset and gain of the inverse over the amplitude; its phase and the gain's slope show the stairs."""
    figure, all_panels = panels(
        4, f"Describing function of the inverse, sine about {inverse.swept.offset_um:g} um", 1.9
    )
    amplitude, gain = inverse.swept.amplitude_um, inverse.swept.gain_V_per_um
    middle = 0.5 * (amplitude[1:] + amplitude[:-1])
    curves = (
        (amplitude, inverse.swept.v0_V, "offset $v_0$, V"),
        (amplitude, np.abs(gain), "gain $|N|$, V/um"),
        (amplitude, np.degrees(np.angle(gain)), "phase of $N$, deg"),
        (middle, 1e3 * np.diff(np.abs(gain)) / np.diff(amplitude), "slope of $|N|$,\n$10^{-3}$ V/um$^2$"),
    )
    for panel, (x, y, label) in zip(all_panels, curves, strict=True):
        panel.plot(x, y, lw=1.2)
        for threshold in inverse.thresholds_um[inverse.thresholds_um < amplitude[-1]]:
            panel.axvline(threshold, color="grey", lw=0.6, ls=":")
        panel.set(ylabel=label, xlim=(0.0, amplitude[-1]))
        panel.grid(alpha=0.3, axis="y")
    all_panels[-1].set_xlabel(r"amplitude, um  (dotted: thresholds $\hat r_i$)")
    return figure


def gain_over_offsets(inverse: Inverse) -> Figure:
    """Map of |N| over amplitude and offset; white where the sine would leave the set-point's range."""
    over = inverse.over_offsets
    figure, (panel,) = panels(1, "Gain |N| of the inverse, V/um")
    drawn = panel.pcolormesh(
        over.amplitude_um, over.offset_um, np.abs(over.gain_V_per_um), shading="nearest", rasterized=True
    )
    finite = np.isfinite(over.gain_V_per_um)
    if np.ptp(np.abs(over.gain_V_per_um[finite]), axis=0) > 0:
        lines = panel.contour(
            over.amplitude_um, over.offset_um, np.abs(over.gain_V_per_um), 8, colors="white", linewidths=0.7
        )
        panel.clabel(lines, fontsize="x-small")
    panel.set(xlabel="amplitude, um", ylabel="offset, um")
    figure.colorbar(drawn, ax=panel, label="gain |N|, V/um")
    return figure


def curve(loop: System) -> tuple[Array, NDArray[np.complex128]]:
    """Frequencies (Hz) and L on the refined grid."""
    omega, L = refined(
        loop.response, grid(loop.period_s, np.concatenate([loop.poles, np.linalg.eigvals(loop.closed())]))
    )
    return omega / (2 * np.pi), L


def bode(loops: dict[str, tuple[System, Margins]]) -> Figure:
    """Loop transfers L, and the sensitivities 1/|1 + L|."""
    figure, (size, angle, sensitivity) = panels(3, "Loop transfers and sensitivity", 1.7)
    for name, (loop, found) in loops.items():
        hertz, L = curve(loop)
        shown = hertz > _SHOWN_HZ
        hertz, L = hertz[shown], L[shown]
        colour = _colour(name)
        size.loglog(hertz, np.abs(L), color=colour, lw=1.0, label=name)
        turned = np.degrees(np.angle(L))
        turned[1:][np.abs(np.diff(turned)) > 180.0] = np.nan
        angle.semilogx(hertz, turned, color=colour, lw=1.0)
        sensitivity.loglog(hertz, 1.0 / np.abs(1.0 + L), color=colour, lw=1.0, label=_said(name, found))
    size.axhline(1.0, color="black", lw=0.6)
    size.set(ylabel="|L|", ylim=(1e-3, 1e3))
    angle.axhline(-180.0, color="black", lw=0.6)
    angle.set(ylabel="phase of L, deg", yticks=[-180, -90, 0, 90, 180])
    sensitivity.axhline(1.0, color="black", lw=0.6)
    sensitivity.set(ylabel="1/|1 + L|", ylim=(1e-2, 10.0), xlabel="frequency, Hz")
    sensitivity.legend(fontsize="small", loc="lower right")
    for panel in (size, angle, sensitivity):
        panel.grid(alpha=0.3)
    return figure


def _colour(name: str) -> str:
    """Of a loop by its name, which says the slope that it holds for."""
    return _AT_WORST if "worst" in name else next(c for loop, c in _COLOURS.items() if name.startswith(loop))


def _said(name: str, found: Margins) -> str:
    text = f"{name}: Ms {found.sensitivity:.2f}, {found.gain_dB:.1f} dB, {found.phase_deg:.0f} deg"
    return text if found.stable else f"{name}: UNSTABLE"


def nyquist(loops: dict[str, tuple[System, Margins]], accept: Accept) -> Figure:
    """Nyquist curves near -1, with the circle that Ms keeps free of L and the criteria's marks."""
    figure = Figure(figsize=(7.0, 6.4), layout="constrained")
    figure.suptitle("Nyquist curves; circles: distance 1/Ms to -1")
    panel = figure.subplots()
    turn = np.exp(1j * np.linspace(0, 2 * np.pi, 181))
    panel.plot(turn.real, turn.imag, color="grey", lw=0.6, ls=":")
    for name, (loop, found) in loops.items():
        _, L = curve(loop)
        panel.plot(L.real, L.imag, color=_colour(name), lw=1.1, label=_said(name, found))
        circle = -1.0 + found.modulus * turn
        panel.plot(circle.real, circle.imag, color=_colour(name), lw=0.8, ls="--")
    panel.plot(-1.0, 0.0, "k+", ms=10)
    wanted = np.radians(180.0 - accept.phase_margin_deg)
    panel.plot([np.cos(wanted)] * 2, [np.sin(wanted), -np.sin(wanted)], "kx", ms=6)
    asked = f"{accept.gain_margin_dB:g} dB, {accept.phase_margin_deg:g} deg"
    panel.plot(-(10.0 ** (-accept.gain_margin_dB / 20.0)), 0.0, "kx", ms=6, label=asked)
    panel.set(xlim=(-2.5, 1.5), ylim=(-2.0, 2.0), aspect="equal", xlabel="real part", ylabel="imaginary part")
    panel.legend(fontsize="small", loc="upper right")
    panel.grid(alpha=0.3)
    return figure


def drawn_plants(samples: tuple[Sample, ...], accept: Accept) -> Figure:
    """Ms and phase margin of each drawn plant, unstable ones along the right edge; and Ms over what matters most."""
    figure, (top, bottom) = panels(2, f"Margins of {len(samples)} drawn plants", 1.6)
    for name, of in (("strain loop", "strain"), ("outer loop", "stage")):
        pairs = [(s, getattr(s, of)) for s in samples]
        stable: list[tuple[Sample, Margins]] = [(s, m) for s, m in pairs if m is not None and m.stable]
        lost = [s for s, m in pairs if m is not None and not m.stable]
        if not stable and not lost:
            continue
        colour, label = _COLOURS[name], f"{name}, {len(stable)} of {len(stable) + len(lost)} stable"
        x = [min(m.sensitivity, _FAR) for _, m in stable]
        top.plot(x, [min(m.phase_deg, 90.0) for _, m in stable], "o", ms=3.5, color=colour, alpha=0.7, label=label)
        bottom.plot([_frequency(s) for s, _ in stable], x, "o", ms=3.5, color=colour, alpha=0.7)
        bottom.plot([_frequency(s) for s in lost], [_FAR] * len(lost), "x", ms=6, color=colour)
        top.plot([_FAR] * len(lost), [0.0] * len(lost), "x", ms=6, color=colour)
    bottom.axhline(accept.robust_sensitivity, color="black", lw=0.6)
    top.set(xscale="log", xlabel=f"Ms (x: unstable, or above {_FAR:g})", ylabel="phase margin, deg")
    top.legend(fontsize="small")
    bottom.set(yscale="log", xlabel="frequency of the flexure's mode over its nominal one", ylabel="Ms")
    for panel, ticks in ((top, top.xaxis), (bottom, bottom.yaxis)):
        ticks.set_major_locator(FixedLocator([1.5, 2.0, 3.0, 5.0, 10.0, 20.0]))
        ticks.set_major_formatter("{x:g}")
        ticks.set_minor_locator(NullLocator())
        panel.grid(alpha=0.3)
    return figure


def _frequency(sample: Sample) -> float:
    return float(np.sqrt(sample.drawn.stiffness / sample.drawn.stage_mass))


def loops_of(analysis: AxisAnalysis) -> dict[str, tuple[System, Margins]]:
    """The loops that there are by name: the strain loop at the identified slope, and at the worst if another."""
    loops: dict[str, tuple[System, Margins]] = {}
    if analysis.strain is not None:
        i = int(np.argmin(np.abs(np.array(analysis.strain.slopes) - 1.0)))
        loops["strain loop, identified slope"] = analysis.strain.loops[i], analysis.strain.margins[i]
        k = int(np.argmax([m.sensitivity for m in analysis.strain.margins]))
        if k != i:
            name = f"strain loop, worst slope ({analysis.strain.slopes[k]:.2f} times)"
            loops[name] = analysis.strain.loops[k], analysis.strain.margins[k]
    if analysis.stage is not None:
        loops["outer loop"] = analysis.stage.loop, analysis.stage.margins
    return loops


def draw_analysis(analysis: AxisAnalysis, folder: Path, about: str = "") -> list[Path]:
    """Draw what the analysis of one axis has into `folder`; the files. `about` says where it comes from."""
    drawings: dict[str, Any] = {}
    if analysis.inverse is not None:
        drawings["figure7_describing_function"] = describing_function(analysis.inverse)
        drawings["describing_map"] = gain_over_offsets(analysis.inverse)
    loops = loops_of(analysis)
    if loops:
        drawings["bode"], drawings["nyquist"] = bode(loops), nyquist(loops, analysis.settings.accept)
    if analysis.samples:
        drawings["drawn_plants"] = drawn_plants(analysis.samples, analysis.settings.accept)
    return [save(figure, folder, f"{name}_{analysis.axis}", about=about) for name, figure in drawings.items()]
