"""What every figure is drawn on, and how it becomes files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from ..report.model import Plot
from ..report.page import thinned

_WIDTH, _DPI = 7.0, 130


def save(plots: Sequence[Plot], folder: Path, name: str, title: str = "", columns: int = 1, about: str = "") -> Path:
    """Write a picture of `plots` as SVG, whole or not at all; the file. Raises OSError.

    `about` stands below it in small print: where it comes from.
    """
    figure = drawn(plots, title, columns)
    if about:
        figure.supxlabel(about, fontsize="x-small", color="dimgrey")
    file = folder / f"{name}.svg"
    try:
        with rc_context({"svg.hashsalt": "micromanip"}):  # the same figure, the same bytes
            figure.savefig(file, dpi=_DPI, metadata={"Date": None})
    except OSError:
        file.unlink(missing_ok=True)
        raise
    return file


def drawn(plots: Sequence[Plot], title: str = "", columns: int = 1) -> Figure:
    """The plots below one another, or in several columns."""
    rows = -(-len(plots) // columns)
    figure = Figure(figsize=((_WIDTH, 4.6 * columns)[columns > 1], 3.4 * rows), layout="constrained")
    figure.suptitle(title)
    for panel, plot in zip(figure.subplots(rows, columns, squeeze=False).flat, plots, strict=False):
        for curve in plot.curves:
            x, y = (curve.x, curve.y) if curve.marks else thinned(curve.x, curve.y, log_x=plot.log_x)
            look, alpha = "o" if curve.marks else "-", 0.3 if curve.faint else 1.0
            panel.plot(x, y, look, lw=0.9, ms=3.0, alpha=alpha, label=curve.label)
            for x_here, y_here, text in zip(curve.x, curve.y, curve.texts, strict=False):
                panel.annotate(text, (x_here, y_here), (4, 2), textcoords="offset points", fontsize="x-small")
        panel.set(xlabel=plot.x_label, ylabel=plot.y_label)
        panel.set_title(plot.title, fontsize="medium")
        panel.set_xscale("log" if plot.log_x else "linear")
        panel.set_yscale("log" if plot.log_y else "linear")
        if plot.equal:
            panel.set_aspect("equal", adjustable="datalim")
        panel.grid(alpha=0.3)
        if len(plot.curves) > 1:
            panel.legend(fontsize="small")
    return figure
