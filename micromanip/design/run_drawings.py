"""Pictures of one recorded run, or of two together: the same quantity in one panel, or on one scale.

They are thinned to what can be seen: of each column of pixels the least and the greatest value. No peak is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from micromanip.rt.states import STATE_NAMES

from .page import COLOURS, GREY, INK, drawing
from .recorded_run import RecordedRun

_LINES = 800
_STATE_COLOURS = {"TRACKING": "#31a354", "FAULT": "#de2d26", "HOLDING": "#fdae61", "ARMING": "#2b8cbe"}
LETTERS = "AB"


def errors(runs: Sequence[RecordedRun]) -> Figure:
    """Path error of every axis while tracking, a panel a run on one scale, with the states and marks below."""
    figure, panels = drawing(rows=len(runs), height=3.2 if len(runs) == 1 else 5.2)
    for run, panel in zip(runs, panels[:, 0], strict=True):
        for place, axis in enumerate(run.axes):
            cycles, low, high = run.error.of(place)
            where = (cycles - run.cell.first) * run.period_s
            panel.fill_between(where, low, high, color=COLOURS[place], alpha=0.6, linewidth=0.5, label=axis)
        _states(panel, run)
        panel.set(ylabel=_of_run("path error, um", runs, run))
    _one_scale(panels[:, 0])
    panels[-1, 0].set(xlabel="time, s")
    _legend(panels[0, 0])
    return figure


def densities(runs: Sequence[RecordedRun]) -> Figure:
    """Amplitude density of the path error while tracking; of two runs a panel an axis."""
    axes = shared_axes(runs)
    figure, panels = drawing(columns=1 if len(runs) == 1 else len(axes))
    for place, axis in enumerate(axes):
        panel = panels[0, 0 if len(runs) == 1 else place]
        for number, run in enumerate(runs):
            frequency, density = run.axis[axis].spectra.frequency_Hz, run.axis[axis].spectra.density
            kept = np.unique(np.geomspace(1, len(frequency) - 1, _LINES).astype(int))
            colour, label = (COLOURS[place], axis) if len(runs) == 1 else (COLOURS[number], LETTERS[number])
            shown = np.sqrt(density[kept])
            panel.loglog(frequency[kept], shown, color=colour, linewidth=0.8, alpha=0.85, label=label)
        panel.set(xlabel="frequency, Hz", title="" if len(runs) == 1 else axis)
    panels[0, 0].set(ylabel="um / sqrt(Hz)")
    _one_scale(panels[0])
    _legend(panels[0, 0])
    return figure


def headroom(runs: Sequence[RecordedRun]) -> Figure:
    """Voltage to the nearer end of the range, a panel a run."""
    figure, panels = drawing(rows=len(runs), height=2.6 if len(runs) == 1 else 4.4)
    for run, panel in zip(runs, panels[:, 0], strict=True):
        for place, axis in enumerate(run.axes):
            cycles, low, _ = run.left.of(place)
            if len(cycles):
                panel.plot(
                    (cycles - run.cell.first) * run.period_s, low, color=COLOURS[place], linewidth=0.8, label=axis
                )
        panel.set(ylabel=_of_run("voltage left, V", runs, run), ylim=(0, None))
    _one_scale(panels[:, 0])
    panels[-1, 0].set(xlabel="time, s")
    _legend(panels[0, 0])
    return figure


def loops(runs: Sequence[RecordedRun]) -> Figure:
    """Gauge over voltage, a panel an axis."""
    axes = shared_axes(runs)
    figure, panels = drawing(columns=len(axes))
    for place, (panel, axis) in enumerate(zip(panels[0], axes, strict=True)):
        for number, run in enumerate(runs):
            voltage, strain = run.axis[axis].loop.values
            colour = COLOURS[place if len(runs) == 1 else number]
            panel.plot(voltage, strain, color=colour, linewidth=0.5, alpha=0.8, label=LETTERS[number])
        panel.set(title=axis, xlabel="voltage, V", ylabel="gauge, um" if place == 0 else "")
    if len(runs) > 1:
        _legend(panels[0, 0])
    return figure


def timing(runs: Sequence[RecordedRun]) -> Figure:
    """Share of cycles that took longer; of two runs a panel for lateness, one for compute time."""
    names = ("lateness", "compute")
    figure, panels = drawing(columns=1 if len(runs) == 1 else len(names), height=2.6)
    for place, name in enumerate(names):
        panel = panels[0, 0 if len(runs) == 1 else place]
        for number, run in enumerate(runs):
            values, ranks = run.cell.timing[name].sorted()
            count = int(ranks[-1])
            rank = np.unique(count - np.geomspace(1, count, 400).astype(int))
            colour, label = (COLOURS[place], name) if len(runs) == 1 else (COLOURS[number], LETTERS[number])
            shown = np.maximum(values[np.searchsorted(ranks, rank, side="right")], 1) / 1e3
            panel.loglog(shown, (count - rank) / count, color=colour, label=label)
        panel.set(xlabel="longer than, us" if len(runs) == 1 else f"{name} longer than, us")
    panels[0, 0].set(ylabel="share of cycles")
    _legend(panels[0, 0])
    return figure


def shared_axes(runs: Sequence[RecordedRun]) -> list[str]:
    """Axes that all of them have."""
    return [axis for axis in runs[0].axes if all(axis in run.axes for run in runs)]


def _of_run(label: str, runs: Sequence[RecordedRun], run: RecordedRun) -> str:
    return label if len(runs) == 1 else f"{LETTERS[runs.index(run)]}: {label}"


def _legend(panel: Any) -> None:
    """Above the panel at its right end: in it there are traces everywhere."""
    if panel.get_legend_handles_labels()[0]:
        panel.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1, frameon=False, labelcolor=INK
        )


def _one_scale(panels: Sequence[Any]) -> None:
    limits = [panel.get_ylim() for panel in panels]
    for panel in panels:
        panel.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))


def _states(panel: Any, run: RecordedRun) -> None:
    for first, last, state in run.cell.states:
        colour = _STATE_COLOURS.get(STATE_NAMES[state], GREY)
        panel.axvspan(run.at_s(first), run.at_s(last), ymax=0.03, color=colour, linewidth=0)
    for gap in run.unread:
        begin = run.cell.first if gap.first is None else gap.first
        end = run.cell.last if gap.last is None else gap.last
        panel.axvspan(run.at_s(begin), run.at_s(end), color=GREY, alpha=0.4, linewidth=0)
    for mark in run.telemetry.marks[1:]:
        panel.axvline(run.at_s(min(max(mark["cycle"], run.cell.first), run.cell.last)), color=GREY, linestyle=":")
