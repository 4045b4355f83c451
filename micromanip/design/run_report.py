"""A recorded run as one page of HTML: what it did, as figures and pictures, in light and in dark.

Pictures are drawn in the page itself (SVG), thinned to what can be seen: of each column of pixels the least and the
greatest value, so that no peak is lost.
"""

from __future__ import annotations

import html
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.signal import welch

from micromanip.recordings import Telemetry
from micromanip.rt.states import STATE_NAMES, TRACKING

from .page import COLOURS, GREY, drawing, page, section, table
from .run_figures import RunFigures

_COLUMNS, _LOOP_POINTS = 600, 1500
_STATE_COLOURS = {"TRACKING": "#31a354", "FAULT": "#de2d26", "HOLDING": "#fdae61", "ARMING": "#2b8cbe"}
_ABOUT_ERRORS = (
    "While tracking, least and greatest value. The bar: blue arming, green tracking, yellow holding, red fault."
)


def run_report(telemetry: Telemetry, figures: RunFigures) -> str:
    """The page. CheckFailed where the recording is damaged."""
    cycles = telemetry.column("cycle")
    t_s = (cycles - cycles[0]) * (telemetry.period_ns * 1e-9)
    states = telemetry.column("state")
    parts = [
        _summary(telemetry, figures),
        section("Path error", _ABOUT_ERRORS, _errors(telemetry, t_s, states)),
        section("Spectrum of the path error", "While tracking; Welch, Hann window.", _spectra(telemetry, states)),
        section("Voltage left", "To the nearer end of the range that the limiter keeps.", _headroom(telemetry, t_s)),
        section("Hysteresis loop", "Gauge over voltage, as it was driven.", _loops(telemetry)),
        section("Timing", "Share of cycles that took longer.", _timing(telemetry)),
        _remarks(telemetry),
        f"<details><summary>Configuration, sha256 {html.escape(telemetry.sha256[:16])}</summary>"
        f"<pre>{html.escape(telemetry.configuration)}</pre></details>",
    ]
    return page(f"Run {telemetry.file.name}", parts)


def _summary(telemetry: Telemetry, figures: RunFigures) -> str:
    whole = "ended in order" if telemetry.end.get("complete") else telemetry.end.get("problem") or "broken off"
    facts = (
        f"{figures.seconds:.1f} s, of which {figures.tracking_s:.1f} s tracking; {figures.skipped} cycles skipped by "
    )
    facts += f"overruns, {figures.lost} lost by the recorder; faults: {', '.join(figures.faults) or 'none'}; {whole}."
    axes = [
        [name, f"{axis.rms_um:.4f}", f"{axis.max_um:.3f}", f"{axis.peak_Hz:.1f}", f"{axis.peak_um:.4f}",
         "-" if axis.headroom_V is None else f"{axis.headroom_V:.1f}"]
        for name, axis in figures.axes.items()
    ]  # fmt: skip
    head = ("axis", "error rms, um", "max, um", "most of it at, Hz", "there, um rms", "least voltage left, V")
    timing = [
        [name, *(f"{value / 1e3:.2f}" for value in values)]
        for name, values in (("lateness", figures.lateness_ns), ("compute", figures.compute_ns))
    ]
    return f"<p>{html.escape(facts)}</p>{table(head, axes)}{table(('us', 'p50', 'p99.9', 'max'), timing)}"


def _envelope(t_s: NDArray[Any], values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Time, least and greatest known value of each column of pixels."""
    edges = np.unique(np.linspace(0, len(values), _COLUMNS + 1).astype(int))[:-1]
    known = np.isfinite(values)
    low = np.minimum.reduceat(np.where(known, values, np.inf), edges)
    high = np.maximum.reduceat(np.where(known, values, -np.inf), edges)
    some = low <= high
    return t_s[edges][some], low[some], high[some]


def _errors(telemetry: Telemetry, t_s: NDArray[Any], states: NDArray[Any]) -> Figure:
    figure, panels = drawing()
    panel = panels[0, 0]
    for place, name in enumerate(telemetry.axes):
        error = np.where(states == TRACKING, telemetry.column(f"axis.{place}.path_error_um"), np.nan)
        where, low, high = _envelope(t_s, error)
        panel.fill_between(where, low, high, color=COLOURS[place], alpha=0.6, linewidth=0.5, label=name)
    changes = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist(), len(states)]
    for first, last in pairwise(changes):
        colour = _STATE_COLOURS.get(STATE_NAMES[int(states[first])], GREY)
        panel.axvspan(t_s[first], t_s[last - 1], ymax=0.03, color=colour, linewidth=0)
    for mark in telemetry.marks[1:]:
        at = np.searchsorted(telemetry.column("cycle"), mark["cycle"])
        panel.axvline(t_s[min(int(at), len(t_s) - 1)], color=GREY, linestyle=":")
    panel.set(xlabel="time, s", ylabel="path error, um")
    panel.legend(loc="upper right", frameon=False, labelcolor=GREY)
    return figure


def _spectra(telemetry: Telemetry, states: NDArray[Any]) -> Figure:
    figure, panels = drawing()
    rate_Hz = 1e9 / telemetry.period_ns
    for place, name in enumerate(telemetry.axes):
        error = telemetry.column(f"axis.{place}.path_error_um")
        error = error[(states == TRACKING) & np.isfinite(error)]
        frequency, density = welch(error, rate_Hz, nperseg=min(len(error), round(rate_Hz)))
        kept = np.unique(np.geomspace(1, len(frequency) - 1, 800).astype(int))
        panels[0, 0].loglog(frequency[kept], np.sqrt(density[kept]), color=COLOURS[place], linewidth=0.8, label=name)
    panels[0, 0].set(xlabel="frequency, Hz", ylabel="um / sqrt(Hz)")
    panels[0, 0].legend(loc="lower left", frameon=False, labelcolor=GREY)
    return figure


def _headroom(telemetry: Telemetry, t_s: NDArray[Any]) -> Figure:
    figure, panels = drawing(height=2.6)
    for place, name in enumerate(telemetry.axes):
        if telemetry.parameters:
            limiter = telemetry.parameters[-1]["axis"][0, place]["limiter"]
            voltage = telemetry.column(f"axis.{place}.voltage_V")
            left = np.minimum(voltage - limiter["low_V"], limiter["high_V"] - voltage)
            where, low, _ = _envelope(t_s, left)
            panels[0, 0].plot(where, low, color=COLOURS[place], linewidth=0.8, label=name)
    panels[0, 0].set(xlabel="time, s", ylabel="voltage left, V", ylim=(0, None))
    panels[0, 0].legend(loc="upper right", frameon=False, labelcolor=GREY)
    return figure


def _loops(telemetry: Telemetry) -> Figure:
    figure, panels = drawing(columns=len(telemetry.axes))
    for place, (panel, name) in enumerate(zip(panels[0], telemetry.axes, strict=True)):
        voltage, strain = (telemetry.column(f"axis.{place}.{field}") for field in ("voltage_V", "strain_um"))
        step = max(1, len(voltage) // _LOOP_POINTS)
        panel.plot(voltage[::step], strain[::step], color=COLOURS[place], linewidth=0.5)
        panel.set(title=name, xlabel="voltage, V", ylabel="gauge, um" if place == 0 else "")
    return figure


def _timing(telemetry: Telemetry) -> Figure:
    figure, panels = drawing(height=2.6)
    for place, name in enumerate(("lateness", "compute")):
        values = np.sort(telemetry.column(f"{name}_ns"))
        rank = np.unique(len(values) - np.geomspace(1, len(values), 400).astype(int))
        panels[0, 0].loglog(
            np.maximum(values[rank], 1) / 1e3, (len(values) - rank) / len(values), color=COLOURS[place], label=name
        )
    panels[0, 0].set(xlabel="longer than, us", ylabel="share of cycles")
    panels[0, 0].legend(loc="lower left", frameon=False, labelcolor=GREY)
    return figure


def _remarks(telemetry: Telemetry) -> str:
    rows = [(str(mark["cycle"]), mark["time"], mark["by"], mark["text"]) for mark in telemetry.marks]
    return f"<h2>Marks</h2>{table(('cycle', 'time', 'by', 'mark'), rows)}" if rows else ""
