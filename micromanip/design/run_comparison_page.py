"""Two recorded runs as one page of HTML: what differs for sure, what was set otherwise, and the pictures of both."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

from micromanip.settings.schema.model import Configuration
from micromanip.settings.text import units
from micromanip.settings.text.shape import Shape

from . import run_drawings as drawn
from .page import page, section, table
from .recorded_run import RecordedRun
from .run_comparison import ERROR, TOO_SHORT, Judged
from .run_confidence import SAME
from .run_figures import RunFigures
from .run_report import (
    ABOUT_ERRORS,
    ABOUT_HEADROOM,
    ABOUT_LOOPS,
    ABOUT_SPECTRUM,
    ABOUT_TIMING,
    facts,
    remarks,
)

_MOST_TEXT = 160
_METHOD = (
    "Each line is judged by itself, with 95 % confidence: of {count} lines {chance:.0f} may be called lower or higher "
    "by chance where the runs are of one kind. Cycles are not independent of one another: means are taken of batches "
    "long beside their memory (batch means: Law and Kelton, Simulation Modeling and Analysis, 9.5), and the intervals "
    "are those of Welch's test on the batches. A greatest or least value and a percentile are taken of sections of one "
    "length in both runs, and their mean is compared."
)


def comparison_page(
    runs: Sequence[RecordedRun],
    figures: Sequence[RunFigures],
    found: Sequence[Judged],
    changes: Sequence[dict[str, Any]],
) -> str:
    """The page of two runs. `found` is what `judged` says of them, `changes` the keys in which they differ."""
    parts = [
        _heads(runs, figures),
        _differences(found),
        _parameters(runs, changes),
        section("Path error", ABOUT_ERRORS, drawn.errors(runs)),
        section("Spectrum of the path error", ABOUT_SPECTRUM, drawn.densities(runs)),
        section("Voltage left", ABOUT_HEADROOM, drawn.headroom(runs)),
        section("Hysteresis loop", ABOUT_LOOPS, drawn.loops(runs)),
        section("Timing", ABOUT_TIMING, drawn.timing(runs)),
        *(remarks(f"Marks of {letter}", run) for letter, run in zip(drawn.LETTERS, runs, strict=True)),
    ]
    names = (run.telemetry.file.name for run in runs)
    return page(" and ".join(f"{letter} {name}" for letter, name in zip(drawn.LETTERS, names, strict=True)), parts)


def _heads(runs: Sequence[RecordedRun], figures: Sequence[RunFigures]) -> str:
    lines = [
        f"<p><b>{letter}</b> {html.escape(f'{run.telemetry.file.name}: {facts(run, found)}')}</p>"
        for letter, run, found in zip(drawn.LETTERS, runs, figures, strict=True)
    ]
    return "".join(lines)


def _differences(found: Sequence[Judged]) -> str:
    sure = [each for each in found if each.verdict not in (SAME, TOO_SHORT)]
    short = sum(each.verdict == TOO_SHORT for each in found)
    told = f"{len(sure)} of {len(found)} quantities differ by more than their confidence"
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
    method = _METHOD.format(count=len(found) - short, chance=0.05 * (len(found) - short))
    all_of_them = f"<details><summary>All {len(rows)} quantities</summary>{table(head, rows)}</details>"
    first = [row for row, each in zip(rows, found, strict=True) if each in sure or each.quantity == ERROR]
    return f"<h2>What differs</h2><p>{told}</p>{table(head, first)}{all_of_them}<p><small>{method}</small></p>"


def _parameters(runs: Sequence[RecordedRun], changes: Sequence[dict[str, Any]]) -> str:
    rows = [
        (change["key"], _short(change["old"]), _short(change["new"]), *_meaning(change["key"])) for change in changes
    ]
    shown = table(("key", "A", "B", "unit", "meaning"), rows, words=True) if rows else "<p>None.</p>"
    several = [
        f"{letter} ran with {len(run.telemetry.parameters)} sets of parameters: some were changed while it ran, "
        "which the configuration that it was started with does not say."
        for letter, run in zip(drawn.LETTERS, runs, strict=True)
        if len(run.telemetry.parameters) > 1
    ]
    return f"<h2>Parameters that differ</h2>{shown}{''.join(f'<p>{line}</p>' for line in several)}"


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.10g}"
    text = "not there" if value is None else str(value)
    return text if len(text) <= _MOST_TEXT else f"{text[:_MOST_TEXT]} ..."


def _meaning(key: str) -> tuple[str, str]:
    """Unit and description of a key, as the schema has them; empty for a driver's own options."""
    parts = key.split(".")
    return units.words_for(parts[-1]) or "", Shape.of(Configuration).at(parts).description
