"""A report as HTML, for a screen, a phone or paper; every text that comes from elsewhere is escaped here."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from importlib.resources import files
from itertools import count
from string import Template

from .drawing import figure_json, style
from .model import Plot, Section

HINT = """<noscript><p class="verdict none">The plots are drawn by a script inside this file; this viewer runs none.</p>
</noscript><p class="hint">Plots: point at a curve for its figures, drag to zoom, double-click to see all again.</p>"""


def whole(title: str, head: str, body: str) -> str:
    """The page: `title` is text, `head` (below it) and `body` are HTML."""
    return Template(_template("report.html")).substitute(
        title=escape(title), style=_template("report.css"), head=head, body=body, script=_template("report.js")
    )


def page_of(title: str, sections: Iterable[Section]) -> str:
    """The page of some sections."""
    ids = count(1)
    return whole(title, HINT, "".join(section(each, ids) for each in sections))


def _template(name: str) -> str:
    return (files(__package__) / "templates" / name).read_text(encoding="utf-8")


def _folded(caption: str, inside: str) -> str:
    return f"<details><summary>{escape(caption)}</summary>{inside}</details>"


def facts(pairs: Mapping[str, str]) -> str:
    """Names and values."""
    items = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in pairs.items())
    return f"<dl>{items}</dl>" if items else ""


def section(section: Section, ids: Iterator[int], level: int = 2, of: str = "") -> str:
    """A section below a heading of that level; `ids` numbers the plots of the page, `of` says what they belong to."""
    paragraphs = "".join(
        f"<p>{escape(text.strip())}</p>" for text in re.split(r"\n\s*\n", section.text) if text.strip()
    )
    tables = "".join(
        _folded(table.caption, rows) if table.folded else rows
        for table in section.tables
        for rows in [table_of(table.caption, table.heads, [[escape(cell) for cell in row] for row in table.rows])]
    )
    plots = "".join(_plot(plot, of, next(ids)) for plot in section.plots)
    return (
        f"<section><h{level}>{escape(section.title)}</h{level}>{paragraphs}{facts(section.figures)}{tables}"
        + (f'<div class="plots">{plots}</div>' if plots else "")
        + (_folded("As text", f"<pre>{escape(section.listing)}</pre>") if section.listing else "")
        + "</section>\n"
    )


def _plot(plot: Plot, of: str, number: int) -> str:
    """A figure: heading, legend, place for the drawing, note, and the numbers that the page's script draws."""
    curves = ", ".join(curve.label for curve in plot.curves)
    said = f"{of}{plot.title}: {plot.y_label} over {plot.x_label}. Curves: {curves}. {plot.note}".strip()
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


def table_of(caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
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
