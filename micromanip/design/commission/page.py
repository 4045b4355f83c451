"""Pieces of the report's HTML; every text that comes from elsewhere is escaped here."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from html import escape

from ..criterion import Criterion
from ..plot import Plot
from . import verdict
from .drawing import figure_json, style
from .evidence import Evidence, Section
from .verdict import Verdict

_SIGNS = {Verdict.PASS: "✓", Verdict.LESS: "✓", Verdict.FAIL: "✗", Verdict.NONE: "–"}


def badge(found: Verdict) -> str:
    """The verdict as a word with a sign: it is told without its colour."""
    kind = found.name.lower()
    return f'<strong class="badge {kind}"><span aria-hidden="true">{_SIGNS[found]}</span> {found.value}</strong>'


def facts(pairs: Mapping[str, str]) -> str:
    """Names and values."""
    items = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in pairs.items())
    return f"<dl>{items}</dl>" if items else ""


def axes_table(axes: Sequence[Evidence], hashes: Mapping[str, str]) -> str:
    """A row per axis: verdict, criteria met, hash of the tuning, link to its part."""
    rows = [
        (
            f'<a href="#{_anchor(evidence)}">Axis {escape(evidence.axis)}</a>',
            badge(verdict.of_axis(evidence)),
            f"{sum(c.passed for c in evidence.criteria)} of {len(evidence.criteria)}",
            f"<code>{escape(hashes.get(evidence.axis, 'none'))}</code>",
        )
        for evidence in axes
    ]
    return _table("The axes", ("Axis", "Verdict", "Criteria met", "Tuning hash"), rows)


def criteria_table(evidence: Evidence) -> str:
    """One row per criterion: what was found, what was asked for, PASS or FAIL."""
    rows = [
        (escape(c.name), badge(_verdict(c)), escape(c.value), escape(c.limit))
        for c in sorted(evidence.criteria, key=lambda c: c.passed)
    ]
    return _table(f"Criteria of axis {evidence.axis}", ("Criterion", "Verdict", "Found", "Limit"), rows)


def axis_part(evidence: Evidence, of_hash: str | None, ids: Iterator[int]) -> str:
    """Everything about one axis: a heading, then its sections; `ids` numbers the plots of the page."""
    tuning = f"Tuning hash: <code>{escape(of_hash)}</code>. " if of_hash else ""
    back = '<a href="#verdict">Back to the verdict</a>'
    sections = "".join(_section(section, evidence.axis, ids) for section in evidence.sections)
    return (
        f'<section class="axis" id="{_anchor(evidence)}"><h2>Axis {escape(evidence.axis)} '
        f"{badge(verdict.of_axis(evidence))}</h2><p>{tuning}{back}</p>{sections}</section>\n"
    )


def _section(section: Section, axis: str, ids: Iterator[int]) -> str:
    paragraphs = "".join(
        f"<p>{escape(text.strip())}</p>" for text in re.split(r"\n\s*\n", section.text) if text.strip()
    )
    tables = "".join(
        _table(table.caption, table.heads, [[escape(cell) for cell in row] for row in table.rows])
        for table in section.tables
    )
    plots = "".join(_plot(plot, axis, next(ids)) for plot in section.plots)
    return (
        f"<section><h3>{escape(section.title)}</h3>{paragraphs}{facts(section.figures)}{tables}"
        + (f'<div class="plots">{plots}</div>' if plots else "")
        + "</section>\n"
    )


def _plot(plot: Plot, axis: str, number: int) -> str:
    """A figure: heading, legend, place for the drawing, note, and the numbers that the page's script draws."""
    curves = ", ".join(curve.label for curve in plot.curves)
    said = f"Axis {axis}, {plot.title}: {plot.y_label} over {plot.x_label}. Curves: {curves}. {plot.note}".strip()
    note = f"<figcaption>{escape(plot.note)}</figcaption>" if plot.note else ""
    return (
        f"<figure><h4>{escape(plot.title)}</h4>{_legend(plot)}"
        f'<p class="label" aria-hidden="true">↑ {escape(plot.y_label)}</p>'
        f'<div class="plot{" equal" if plot.equal else ""}" id="plot-{number}" role="img" '
        f'aria-label="{escape(said)}"></div>'
        f'<p class="label along" aria-hidden="true"><span class="readout"></span>{escape(plot.x_label)} →</p>{note}'
        f'<script type="application/json" data-plot="plot-{number}">{figure_json(plot)}</script></figure>\n'
    )


def _legend(plot: Plot) -> str:
    """The curves with a sample of line or mark each; none for a lone curve without a name."""
    if not any(curve.label for curve in plot.curves):
        return ""
    entries = []
    for i, curve in enumerate(plot.curves):
        colour, dash = style(i)
        sample = f'<line x1="0" x2="26" y1="6" y2="6" stroke-dasharray="{dash}"/>'
        if curve.marks:
            sample = '<circle cx="13" cy="6" r="4"/>'
        faint = " faint" if curve.faint else ""
        drawn = f'<svg width="26" height="12" aria-hidden="true"><g class="{colour}{faint}">{sample}</g></svg>'
        entries.append(f"<li>{drawn} {escape(curve.label)}</li>")
    return f'<ul class="legend">{"".join(entries)}</ul>'


def _table(caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose cells are HTML; the first of each row is its header.

    Roles are spelt out, as a phone shows it as blocks and would lose them; `data-head` names a cell there.
    The second column is the verdict, which a phone shows beside the row's header.
    """
    head = "".join(f'<th scope="col" role="columnheader">{escape(text)}</th>' for text in heads)
    body = ""
    for first, *cells in rows:
        data = "".join(
            f'<td role="cell" data-head="{escape(name)}"><span>{cell}</span></td>'
            for name, cell in zip(heads[1:], cells, strict=True)
        )
        body += f'<tr role="row"><th scope="row" role="rowheader">{first}</th>{data}</tr>\n'
    return (
        f'<table role="table"><caption>{escape(caption)}</caption><thead role="rowgroup"><tr role="row">{head}</tr>'
        f'</thead><tbody role="rowgroup">{body}</tbody></table>\n'
    )


def _verdict(criterion: Criterion) -> Verdict:
    return Verdict.PASS if criterion.passed else Verdict.FAIL


def _anchor(evidence: Evidence) -> str:
    return "axis-" + re.sub(r"[^A-Za-z0-9_-]", "-", evidence.axis)
