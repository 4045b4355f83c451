"""The report of a commissioning: the verdict, then the evidence of each axis."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from itertools import count
from pathlib import Path

from micromanip.settings.write import write_atomically

from ..report import page
from ..report.model import Evidence, Verdict, of_axis, overall, sentence

_SIGNS = {Verdict.PASS: "✓", Verdict.LESS: "✓", Verdict.FAIL: "✗", Verdict.NONE: "–"}


def write_report(
    file: Path,
    title: str,
    facts: Mapping[str, str],
    axes: Sequence[Evidence],
    hashes: Mapping[str, str],
) -> None:
    """Write `file`, whole or not at all: the verdict, then the evidence of each of `axes`.

    `facts` are names and values that stand below the verdict (time, configuration, version), `hashes` the
    :func:`~micromanip.settings.tuning_hash.tuning_hash` of each axis by name. The same arguments make the same bytes.
    Raises OSError where the file can't be written,
    ValueError where a curve's x and y differ in length.
    """
    write_atomically(file, _rendered(title, facts, axes, hashes))


def _rendered(
    title: str,
    facts: Mapping[str, str],
    axes: Sequence[Evidence],
    hashes: Mapping[str, str],
) -> str:
    found, numbers = overall(axes), count(1)
    head = (
        f'<p class="verdict {found.name.lower()}" id="verdict">{_badge(found)} '
        f"<span>{escape(sentence(axes))}</span></p>"
    )
    criteria = "".join(_criteria_table(evidence) for evidence in axes if evidence.criteria)
    parts = "".join(_axis_part(evidence, hashes.get(evidence.axis), numbers) for evidence in axes)
    summary = (
        f"<section><h2>Summary</h2>{page.facts(facts)}{_axes_table(axes, hashes)}<h3>Criteria</h3>{criteria}</section>"
    )
    return page.whole(title, head, summary + page.HINT + parts)


def _badge(found: Verdict) -> str:
    """The verdict as a word with a sign: it is told without its colour."""
    kind = found.name.lower()
    return f'<strong class="badge {kind}"><span aria-hidden="true">{_SIGNS[found]}</span> {found.value}</strong>'


def _axes_table(axes: Sequence[Evidence], hashes: Mapping[str, str]) -> str:
    """A row per axis: verdict, criteria met, hash of the tuning, link to its part."""
    rows = [
        (
            f'<a href="#{_anchor(evidence)}">Axis {escape(evidence.axis)}</a>',
            _badge(of_axis(evidence)),
            f"{sum(c.passed for c in evidence.criteria)} of {len(evidence.criteria)}",
            f"<code>{escape(hashes.get(evidence.axis, 'none'))}</code>",
        )
        for evidence in axes
    ]
    return page.table_of("The axes", ("Axis", "Verdict", "Criteria met", "Tuning hash"), rows)


def _criteria_table(evidence: Evidence) -> str:
    """One row per criterion: what was found, what was asked for, PASS or FAIL."""
    rows = [
        (escape(c.name), _badge(Verdict.PASS if c.passed else Verdict.FAIL), escape(c.value), escape(c.limit))
        for c in sorted(evidence.criteria, key=lambda c: c.passed)
    ]
    return page.table_of(f"Criteria of axis {evidence.axis}", ("Criterion", "Verdict", "Found", "Limit"), rows)


def _axis_part(evidence: Evidence, of_hash: str | None, ids: Iterator[int]) -> str:
    """Everything about one axis: a heading, then its sections; `ids` numbers the plots of the page."""
    tuning = f"Tuning hash: <code>{escape(of_hash)}</code>. " if of_hash else ""
    back = '<a href="#verdict">Back to the verdict</a>'
    sections = "".join(page.section(section, ids, 3, f"Axis {evidence.axis}, ") for section in evidence.sections)
    return (
        f'<section class="axis" id="{_anchor(evidence)}"><h2>Axis {escape(evidence.axis)} '
        f"{_badge(of_axis(evidence))}</h2><p>{tuning}{back}</p>{sections}</section>\n"
    )


def _anchor(evidence: Evidence) -> str:
    return "axis-" + re.sub(r"[^A-Za-z0-9_-]", "-", evidence.axis)
