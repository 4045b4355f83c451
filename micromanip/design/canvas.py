"""What every figure is drawn on, and how it becomes files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

_SIZE, _DPI = (7.0, 4.5), 130


def save(figure: Figure, folder: Path, name: str, dpi: int = _DPI, about: str = "") -> Path:
    """Write `figure` as SVG, whole or not at all; the file. Raises OSError.

    `about` stands below it in small print: where it comes from.
    """
    if about:
        figure.supxlabel(about, fontsize="x-small", color="dimgrey")
    lay_out(figure, dpi)
    file = folder / f"{name}.svg"
    try:
        with rc_context({"svg.hashsalt": "micromanip"}):  # the same figure, the same bytes
            figure.savefig(file, dpi=dpi, metadata={"Date": None})
    except OSError:
        file.unlink(missing_ok=True)
        raise
    return file


def lay_out(figure: Figure, dpi: float) -> None:
    """Place the panels of `figure` once; a file of it would be laid out, and drawn in vain, by itself."""
    engine = figure.get_layout_engine()
    if engine is not None:
        figure.dpi = dpi
        engine.execute(figure)
        figure.set_layout_engine(None)


def panels(count: int, title: str, height: float = 1.0) -> tuple[Figure, Any]:
    """A figure with `count` panels below one another, `height` times the usual height."""
    figure = Figure(figsize=(_SIZE[0], _SIZE[1] * height), layout="constrained")
    figure.suptitle(title)
    return figure, figure.subplots(count, 1, squeeze=False)[:, 0]
