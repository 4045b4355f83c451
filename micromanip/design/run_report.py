"""A recorded run as one page of HTML: what it did, as figures and plots."""

from __future__ import annotations

from .recorded_run import RecordedRun
from .report.model import Section, Table
from .report.page import page_of
from .run_figures import RunFigures
from .run_plots import sections

_MOST_TOLD = 5


def run_report(run: RecordedRun, figures: RunFigures) -> str:
    """The page. CheckFailed where the recording is damaged."""
    telemetry = run.telemetry
    configured = f"Started with the configuration of sha256 {telemetry.sha256[:16]}."
    parts = [
        _summary(run, figures),
        *sections([run]),
        *remarks("Marks", run),
        Section("Configuration", configured, listing=telemetry.configuration),
    ]
    return page_of(f"Run {telemetry.file.name}", parts)


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
