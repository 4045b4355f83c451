"""A report as HTML, for a screen, a phone or paper; every text that comes from elsewhere is escaped here.

A plot of the evidence as data for the page's own script, which draws it as SVG, as wide as the screen allows.

Coordinates are given as they are seen (logarithms on a logarithmic axis), in 16 bits of the plot's extent: a screen
shows fewer. Title, legend, labels and note are HTML around the drawing, where they wrap on a phone and are read aloud.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from importlib.resources import files
from itertools import count
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import Array

from .model import Curve, Plot, Section

COLOURS = 7
"""Of the style sheet, c0 to c6, told apart also by people who see no red or no green (Okabe and Ito, 2008)."""
DASHES = ("", "6 3", "2 3")
GAP = 65535
_POINTS_IN_PLOT, _LEAST_POINTS, _MOST_POINTS = 1600, 300, 1000
_ROOM = 0.04


def style(number: int) -> tuple[str, str]:
    """Class and dashes of curve `number` of a plot."""
    return f"c{number % COLOURS}", DASHES[number // COLOURS % len(DASHES)]


def figure_json(plot: Plot) -> str:
    """The drawing as JSON that can stand inside a script element."""
    for curve in plot.curves:
        if curve.x.shape != curve.y.shape:
            raise ValueError(f"{plot.title}: curve {curve.label} has {curve.x.shape} x and {curve.y.shape} y values")
    long = sum(len(curve.x) > _LEAST_POINTS for curve in plot.curves)
    most = min(_MOST_POINTS, max(_LEAST_POINTS, _POINTS_IN_PLOT // max(long, 1)))
    shown = [_seen(plot, *thinned(curve.x, curve.y, most, log_x=plot.log_x)) for curve in plot.curves]
    spans = [_span([values[k] for values in shown]) for k in range(2)]
    figure = {
        "log": [plot.log_x, plot.log_y],
        "equal": plot.equal,
        "span": spans,
        "curves": [_curve(plot.curves[i], *shown[i], spans, *style(i)) for i in range(len(shown))],
    }
    text = json.dumps(figure, separators=(",", ":"), allow_nan=False)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _curve(curve: Curve, x: Array, y: Array, spans: list[list[float]], colour: str, dash: str) -> dict[str, Any]:
    drawn: dict[str, Any] = {"name": curve.label, "class": colour, "dash": dash, "points": _coded(x, y, spans)}
    if curve.marks:
        drawn["marks"] = True
    if curve.faint:
        drawn["faint"] = True
    if curve.texts:
        drawn["texts"] = list(curve.texts)
    return drawn


def _seen(plot: Plot, x: Array, y: Array) -> tuple[Array, Array]:
    """Where the points are seen; what can't be shown is a gap."""
    with np.errstate(invalid="ignore", divide="ignore"):
        out = [np.log10(v) if log else np.asarray(v, float) for v, log in ((x, plot.log_x), (y, plot.log_y))]
    good = np.isfinite(out[0]) & np.isfinite(out[1])
    return np.where(good, out[0], np.nan), np.where(good, out[1], np.nan)


def _span(values: list[Array]) -> list[float]:
    """From the lowest to the highest, with some room."""
    every = np.concatenate([*values, np.zeros(0)])
    every = every[np.isfinite(every)]
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)
    room = _ROOM * (high - low) or 0.5 * max(abs(high), 1e-3)
    return [float(f"{low - room:.8g}"), float(f"{high + room:.8g}")]


def _coded(x: Array, y: Array, spans: list[list[float]]) -> str:
    """Both as unsigned 16-bit numbers, x first; `GAP` in x is a gap."""
    out: list[NDArray[np.uint16]] = []
    for values, (low, high) in zip((x, y), spans, strict=True):
        share = (np.nan_to_num(values, nan=low) - low) / (high - low)
        out.append(np.round(share * (GAP - 1)).astype("<u2"))
    out[0][~np.isfinite(x)] = GAP
    return base64.b64encode(np.concatenate(out).tobytes()).decode()


MOST_POINTS = 2000


def thinned(x: Array, y: Array, most: int = MOST_POINTS, log_x: bool = False) -> tuple[Array, Array]:
    """At most `most` (>= 20) of the points `x` (n,), `y` (n,), in their order.

    Where x never falls, the axis is cut into equal pieces as it is seen (equal in log x with `log_x`), and each
    piece keeps its lowest and its highest point: on paper the curve covers the same. Where x turns back
    (Nyquist, hysteresis), the pieces have as many points each, and the extremes in x are kept as well. A gap (a point
    that is not finite) stays a gap. Short curves are returned as they are.
    """
    if len(x) <= most:
        return x, y
    shown = np.isfinite(x) & np.isfinite(y)
    if log_x:
        shown &= x > 0
    rises = bool(np.all(np.diff(x[shown]) >= 0))
    kinds = (y,) if rises else (x, y)
    pieces = (most - 2) // (2 * len(kinds) + (not shown.all()))
    position = _place(x, shown, log_x) if rises else np.arange(float(len(x)))
    piece = _pieces(position, pieces)
    ends = np.flatnonzero(shown)[[0, -1]] if shown.any() else np.zeros(0, np.int64)
    kept = [_extremes(piece, values, shown) for values in kinds] + [_first(piece, np.flatnonzero(~shown)), ends]
    order = np.unique(np.concatenate(kept))
    return x[order], y[order]


def _place(x: Array, shown: NDArray[np.bool_], log_x: bool) -> Array:
    """Place on the axis; that of what is not shown is where the point before it is."""
    if not shown.any():
        return np.arange(float(len(x)))
    last = np.maximum.accumulate(np.where(shown, np.arange(len(x)), np.argmax(shown)))
    return np.log(x[last]) if log_x else x[last]


def _pieces(position: Array, pieces: int) -> NDArray[np.int64]:
    """Number of the piece each position is in, 0..pieces-1."""
    span = position.max() - position.min()
    share = (position - position.min()) / span if span > 0 else np.linspace(0.0, 1.0, len(position))
    return np.minimum((share * pieces).astype(np.int64), pieces - 1)


def _extremes(piece: NDArray[np.int64], values: Array, shown: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Indices of the lowest and the highest shown value of each piece."""
    candidates = np.flatnonzero(shown)
    order = candidates[np.lexsort((values[candidates], piece[candidates]))]
    edges = np.flatnonzero(np.diff(piece[order]))
    return np.concatenate((order[:1], order[edges], order[edges + 1], order[-1:]))


def _first(piece: NDArray[np.int64], indices: NDArray[np.int64]) -> NDArray[np.int64]:
    """The first of `indices` in each piece."""
    return indices[np.unique(piece[indices], return_index=True)[1]]


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
