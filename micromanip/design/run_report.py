"""A recorded run as one page of HTML: what it did, as figures and pictures, in light and in dark."""

from __future__ import annotations

import html

from . import run_drawings as drawn
from .page import page, section, table
from .recorded_run import RecordedRun
from .run_figures import RunFigures

ABOUT_ERRORS = (
    "While tracking, least and greatest value. The bar: blue arming, green tracking, yellow holding, red fault."
)
ABOUT_HEADROOM = "To the nearer end of the range that the limiter keeps."
ABOUT_LOOPS = "Gauge over voltage, as it was driven."
ABOUT_SPECTRUM = "While tracking; Welch, Hann window, 1 s."
ABOUT_TIMING = "Share of cycles that took longer."
_MOST_TOLD = 5


def run_report(run: RecordedRun, figures: RunFigures) -> str:
    """The page. CheckFailed where the recording is damaged."""
    telemetry = run.telemetry
    parts = [
        _summary(run, figures),
        section("Path error", ABOUT_ERRORS, drawn.errors([run])),
        section("Spectrum of the path error", ABOUT_SPECTRUM, drawn.densities([run])),
        section("Voltage left", ABOUT_HEADROOM, drawn.headroom([run])),
        section("Hysteresis loop", ABOUT_LOOPS, drawn.loops([run])),
        section("Timing", ABOUT_TIMING, drawn.timing([run])),
        remarks("Marks", run),
        f"<details><summary>Configuration, sha256 {html.escape(telemetry.sha256[:16])}</summary>"
        f"<pre>{html.escape(telemetry.configuration)}</pre></details>",
    ]
    return page(f"Run {telemetry.file.name}", parts)


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


def _summary(run: RecordedRun, figures: RunFigures) -> str:
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
    told = html.escape(facts(run, figures))
    return f"<p>{told}</p>{table(head, axes)}{table(('us', 'p50', 'p99.9', 'max'), timing)}"


def remarks(title: str, run: RecordedRun) -> str:
    """The marks of a run as a table; empty where there are none."""
    rows = [(str(mark["cycle"]), mark["time"], mark["by"], mark["text"]) for mark in run.telemetry.marks]
    return f"<h2>{html.escape(title)}</h2>{table(('cycle', 'time', 'by', 'mark'), rows, words=True)}" if rows else ""
