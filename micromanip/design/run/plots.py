"""Plots of one recorded run, or of two together: a plot a quantity and axis, with a curve a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micromanip.rt.states import STATE_NAMES

from ..report.model import Array, Curve, Plot, Section
from .statistics import RecordedRun
from .sums import Envelope

LETTERS = "AB"
_LINES = 800


def sections(runs: Sequence[RecordedRun]) -> list[Section]:
    """Path error with states and marks, its spectrum, voltage left, hysteresis loop and timing."""
    axes = [axis for axis in runs[0].axes if all(axis in run.axes for run in runs)]
    errors = [_over_time(runs, axis, "path error, um") for axis in axes]
    left = [_over_time(runs, axis, "voltage left, V") for axis in axes]
    return [
        Section("Path error", "While tracking, least and greatest value.", {}, (*errors, _states(runs))),
        Section(
            "Spectrum of the path error",
            "While tracking; Welch, Hann window, 1 s.",
            {},
            tuple(_density(runs, axis) for axis in axes),
        ),
        Section("Voltage left", "To the nearer end of the range that the limiter keeps.", {}, tuple(left)),
        Section("Hysteresis loop", "Gauge over voltage, as it was driven.", {}, tuple(_loop(runs, x) for x in axes)),
        Section(
            "Timing",
            "Share of cycles that took longer.",
            {},
            tuple(_timing(runs, name) for name in runs[0].cell.timing),
        ),
    ]


def _name(runs: Sequence[RecordedRun], run: RecordedRun) -> str:
    return LETTERS[runs.index(run)] if len(runs) > 1 else ""


def _over_time(runs: Sequence[RecordedRun], axis: str, what: str) -> Plot:
    curves = []
    for run in runs:
        envelope: Envelope = run.error if what.startswith("path") else run.left
        cycles, low, high = envelope.of(run.axes.index(axis))
        values = np.stack([low, high], axis=1).ravel()
        curves.append(Curve(_name(runs, run), np.repeat((cycles - run.cell.first) * run.period_s, 2), values))
    return Plot(f"Axis {axis}", "time, s", what, tuple(curves))


def _states(runs: Sequence[RecordedRun]) -> Plot:
    """Each state as a line of its own height; marks by their number, and what can't be read."""
    curves = []
    for run in runs:
        name = f"{_name(runs, run)} ".lstrip()
        for state in sorted({each for _, _, each in run.cell.states}):
            spans = [(run.at_s(a), run.at_s(b)) for a, b, each in run.cell.states if each == state]
            curves.append(_spans(name + STATE_NAMES[state], spans, state + 0.2 * runs.index(run)))
        ends = (run.cell.first, run.cell.last)
        unread = [
            (run.at_s(ends[0] if gap.first is None else gap.first), run.at_s(ends[1] if gap.last is None else gap.last))
            for gap in run.unread
        ]
        if unread:
            curves.append(_spans(f"{name}damaged", unread, -1.0))
        marks = run.telemetry.marks[1:]
        if marks:
            at_s = np.array([run.at_s(min(max(mark["cycle"], ends[0]), ends[1])) for mark in marks])
            texts = tuple(str(number) for number in range(2, len(marks) + 2))
            curves.append(Curve(f"{name}marks", at_s, np.full(len(marks), -0.5), marks=True, texts=texts))
    return Plot("States", "time, s", "state", tuple(curves))


def _spans(name: str, spans: Sequence[tuple[float, float]], height: float) -> Curve:
    x = np.array([(begin, end, np.nan) for begin, end in spans]).ravel()
    return Curve(name, x, np.where(np.isfinite(x), height, np.nan))


def _density(runs: Sequence[RecordedRun], axis: str) -> Plot:
    curves = []
    for run in runs:
        frequency, density = run.axis[axis].spectra.frequency_Hz, run.axis[axis].spectra.density
        kept = np.unique(np.geomspace(1, len(frequency) - 1, _LINES).astype(int))
        curves.append(Curve(_name(runs, run), frequency[kept], np.sqrt(density[kept])))
    return Plot(f"Axis {axis}", "frequency, Hz", "um / sqrt(Hz)", tuple(curves), log_x=True, log_y=True)


def _loop(runs: Sequence[RecordedRun], axis: str) -> Plot:
    curves = tuple(Curve(_name(runs, run), *run.axis[axis].loop.values) for run in runs)
    return Plot(f"Axis {axis}", "voltage, V", "gauge, um", curves)


def _timing(runs: Sequence[RecordedRun], name: str) -> Plot:
    curves = []
    for run in runs:
        values, ranks = run.cell.timing[name].sorted()
        count = int(ranks[-1])
        rank = np.unique(count - np.geomspace(1, count, 400).astype(int))
        longer_us: Array = np.maximum(values[np.searchsorted(ranks, rank, side="right")], 1) / 1e3
        curves.append(Curve(_name(runs, run), longer_us, (count - rank) / count))
    return Plot(name.capitalize(), "longer than, us", "share of cycles", tuple(curves), log_x=True, log_y=True)
