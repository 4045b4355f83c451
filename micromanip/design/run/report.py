"""A recorded run, or two side by side, as one page of HTML: figures and plots, and what differs for sure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from micromanip.control.system import Array
from micromanip.rt.states import STATE_NAMES
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text import units
from micromanip.settings.text.shape import Shape

from ..report.model import Curve, Plot, Section, Table
from .comparison import ERROR, NOT_JUDGED, SAME, TOO_SHORT, Compared, RunFigures
from .statistics import RecordedRun

_MOST_TOLD = 5


def run_report(run: RecordedRun, figures: RunFigures) -> Iterator[Section]:
    """The page of one run. CheckFailed where the recording is damaged."""
    telemetry = run.telemetry
    configured = f"Started with the configuration of sha256 {telemetry.sha256[:16]}."
    yield _summary(run, figures)
    yield from sections([run])
    yield from remarks("Marks", run)
    yield Section("Configuration", configured, listing=telemetry.configuration)


def facts(run: RecordedRun, figures: RunFigures) -> str:
    """In a sentence: how long, what was missed, how it ended."""
    whole = "ended in order" if run.telemetry.end else "broken off"
    return (
        f"{figures.seconds:.1f} s, of which {figures.tracking_s:.1f} s tracking; {figures.skipped} cycles skipped by "
        f"overruns, {figures.lost} lost by the recorder; faults: {', '.join(figures.faults) or 'none'}; {whole}."
        + damage(run)
    )


def damage(run: RecordedRun) -> str:
    """Which seconds are missing because the file is damaged there, and why; what beside the rows is left out.

    Empty where all of it could be read.
    """
    beside = f" {run.telemetry.damage()}" if run.telemetry.damaged else ""
    if not run.unread:
        return beside
    told = [
        f"from {'the beginning' if each.first is None else f'{run.at_s(each.first):.3f} s'} "
        f"to {'the end' if each.last is None else f'{run.at_s(each.last + 1):.3f} s'}"
        for each in run.unread[:_MOST_TOLD]
    ]
    more = f" and {len(run.unread) - _MOST_TOLD} more times" if len(run.unread) > _MOST_TOLD else ""
    why = run.unread[0].why
    return f" The file is damaged {', '.join(told)}{more}: that is missing in all figures ({why}).{beside}"


def _summary(run: RecordedRun, figures: RunFigures) -> Section:
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
    tables = (Table("Axes", head, axes), Table("Timing", ("us", "p50", "p99.9", "max"), timing))
    return Section("Summary", facts(run, figures), tables=tables)


def remarks(title: str, run: RecordedRun) -> list[Section]:
    """The marks of a run as a table; none where there are none."""
    rows = [(str(mark["cycle"]), mark["time"], mark["by"], mark["text"]) for mark in run.telemetry.marks]
    table = Table("", ("cycle", "time", "by", "mark"), rows)
    return [Section(title, "", tables=(table,))] if rows else []


_MOST_TEXT = 160
_METHOD = (
    "Each line is judged by itself, with 95 % confidence: of {count} lines {chance:.0f} may be called lower or higher "
    "by chance where the runs are of one kind. Cycles are not independent of one another: means are taken of batches "
    "long beside their memory (batch means: Law and Kelton, Simulation Modeling and Analysis, 9.5), and the intervals "
    "are those of Welch's test on the batches. A greatest or least value and a percentile are told, and not judged."
)


def comparison(
    runs: Sequence[RecordedRun],
    figures: Sequence[RunFigures],
    found: Sequence[Compared],
    changes: Sequence[dict[str, Any]],
) -> Iterator[Section]:
    """The page of two runs. `found` is what `compared` says of them, `changes` the keys in which they differ."""
    named = zip(LETTERS, runs, figures, strict=True)
    told = [f"{letter} {run.telemetry.file.name}: {facts(run, its)}" for letter, run, its in named]
    yield Section("Runs", "\n\n".join(told))
    yield _differences(found)
    yield _parameters(runs, changes)
    yield from sections(runs)
    for letter, run in zip(LETTERS, runs, strict=True):
        yield from remarks(f"Marks of {letter}", run)


def _differences(found: Sequence[Compared]) -> Section:
    judged = [each for each in found if each.verdict != NOT_JUDGED]
    sure = [each for each in judged if each.verdict not in (SAME, TOO_SHORT)]
    short = sum(each.verdict == TOO_SHORT for each in judged)
    told = f"{len(sure)} of {len(judged)} quantities differ by more than their confidence"
    told += f"; for {short} the shorter run is too short." if short else "."
    rows = [
        [
            " ".join(part for part in (each.axis, each.quantity) if part),
            each.unit,
            f"{each.a:.4g}",
            f"{each.b:.4g}",
            f"{each.b - each.a:+.3g}",
            "-" if each.low is None or each.high is None else f"{each.low:+.3g} to {each.high:+.3g}",
            each.verdict,
        ]
        for each in found
    ]
    head = ("quantity", "unit", "A", "B", "B - A", "95 %", "B is")
    method = _METHOD.format(count=len(judged) - short, chance=0.05 * (len(judged) - short))
    first = [row for row, each in zip(rows, found, strict=True) if each in sure or each.quantity == ERROR]
    tables = (Table("", head, first), Table(f"All {len(rows)} quantities", head, rows, folded=True))
    return Section("What differs", f"{told}\n\n{method}", tables=tables)


def _parameters(runs: Sequence[RecordedRun], changes: Sequence[dict[str, Any]]) -> Section:
    rows = [
        (change["key"], _short(change["old"]), _short(change["new"]), *_meaning(change["key"])) for change in changes
    ]
    several = [
        f"{letter} ran with {len(run.telemetry.parameters)} sets of parameters: some were changed while it ran, "
        "which the configuration that it was started with does not say."
        for letter, run in zip(LETTERS, runs, strict=True)
        if len(run.telemetry.parameters) > 1
    ]
    tables = (Table("", ("key", "A", "B", "unit", "meaning"), rows),) if rows else ()
    return Section("Parameters that differ", "\n\n".join(several if rows else ["None.", *several]), tables=tables)


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.10g}"
    text = "not there" if value is None else str(value)
    return text if len(text) <= _MOST_TEXT else f"{text[:_MOST_TEXT]} ..."


def _meaning(key: str) -> tuple[str, str]:
    """Unit and description of a key, as the schema has them; empty for a driver's own options."""
    parts = key.split(".")
    return units.words_for(parts[-1]) or "", Shape.of(Configuration).at(parts).description


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
        ends = (run.axis[axis].error if what.startswith("path") else run.axis[axis].left).found
        at_s = np.repeat((run.cell.shown.found - run.cell.first) * run.period_s, 2)
        curves.append(Curve(_name(runs, run), at_s, ends.ravel()))
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
    pairs = ((run, run.axis[axis].loop) for run in runs)
    curves = tuple(Curve(_name(runs, run), voltage.found, gauge.found) for run, (voltage, gauge) in pairs)
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
