"""A page of HTML that is whole in itself: text, tables and drawings, in light and in dark.

Drawings stand in the page (SVG): nothing is fetched, and nothing in it runs.
"""

from __future__ import annotations

import html
import io
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from .canvas import lay_out

COLOURS = ("#2b8cbe", "#d95f0e", "#31a354")
_SVG_DPI = 72
GREY = "#7f7f7f"
"""Of lines: seen on white and on black."""
INK = "#7f7f7e"
"""Of words in a drawing: in the page they have the colour of its text, whether it is light or dark."""
_DRAWN: Any = {
    "svg.hashsalt": "micromanip",
    "svg.fonttype": "none",
    "font.size": 11,
    "legend.frameon": False,
    **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.labelcolor", "ytick.labelcolor"), INK),
    **dict.fromkeys(("axes.edgecolor", "xtick.color", "ytick.color"), GREY),
}
_STYLE = """
:root { color-scheme: light dark; --ink: #1a1a1a; --ground: #fff; --line: #ccc; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e6e6; --ground: #141414; --line: #444; } }
body { color: var(--ink); background: var(--ground); font: 16px/1.5 system-ui, sans-serif; margin: 1rem auto;
  max-width: 60rem; padding: 0 1rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid var(--line); padding: .2rem .8rem .2rem 0; text-align: right; }
th:first-child, td:first-child { text-align: left; }
table:not(.words) td:first-child { white-space: nowrap; } details { margin: .6rem 0; }
table.words td { text-align: left; vertical-align: top; overflow-wrap: anywhere; min-width: 5rem; }
table.words th { text-align: left; }
table.words td:first-child { overflow-wrap: normal; }
table.words td:last-child { min-width: 14rem; }
.wide { overflow-x: auto; } svg { max-width: 100%; height: auto; }
@media (max-width: 40rem) { .wide > svg { max-width: none; width: 48rem; }
  .wide table:not(.words) td { white-space: nowrap; } table.words td:last-child { min-width: 22rem; } }
pre { overflow-x: auto; font-size: .8rem; }
"""
_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<title>{title}</title><style>{style}</style></head><body><h1>{title}</h1>
{parts}</body></html>
"""


def page(title: str, parts: Sequence[str]) -> str:
    """The document; `parts` are HTML, `title` is text."""
    return _PAGE.format(title=html.escape(title), style=_STYLE, parts="\n".join(parts))


def table(head: Sequence[str], rows: Sequence[Sequence[str]], *, words: bool = False) -> str:
    """Rows of text below a head; its first column is for names, the others for figures, or for `words`."""
    lines = [f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in row)}</tr>" for tag, row in
             [("th", head), *(("td", row) for row in rows)]]  # fmt: skip
    kind = ' class="words"' if words else ""
    return f'<div class="wide"><table{kind}>{"".join(lines)}</table></div>'


def section(title: str, about: str, figure: Figure) -> str:
    """A drawing with its headline and a sentence about it; on a narrow screen it is shifted, and stays legible."""
    drawn = io.StringIO()
    with legible():
        lay_out(figure, _SVG_DPI)
        figure.savefig(drawn, format="svg", transparent=True, metadata={"Date": None})
    text = drawn.getvalue().replace(INK, "currentColor")
    return f'<h2>{title}</h2><p>{about}</p><div class="wide">{text[text.index("<svg") :]}</div>'


def legible() -> AbstractContextManager[None]:
    """Within it figures are made whose text and lines are legible in light and in dark."""
    return rc_context(_DRAWN)


def drawing(rows: int = 1, columns: int = 1, height: float = 3.2) -> tuple[Figure, Any]:
    """A figure as wide as the page, and its axes, shape (rows, columns)."""
    with legible():
        figure = Figure(figsize=(9.0, height), layout="constrained")
        return figure, figure.subplots(rows, columns, squeeze=False)
