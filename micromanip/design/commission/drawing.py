"""A plot of the evidence as a plotly figure, without the network and without a picture yet.

The browser draws it as SVG, as wide as the screen allows. Title, legend, labels and note are HTML around the figure,
where they wrap on a phone and are read aloud.
"""

from __future__ import annotations

import html
from typing import Any

import numpy as np
import plotly.graph_objects as go

from .evidence import Array, Curve, Plot
from .thinning import MOST_POINTS, thinned

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#e69f00", "#56b4e9")
"""Told apart also by people who see no red or no green, and by their lightness (Okabe and Ito, 2008)."""
DASHES = ("solid", "dash", "dot")
_POINTS_IN_PLOT = 2500
_LEAST_POINTS = 300
_GRID = {"gridcolor": "#e3e3e3", "zeroline": False, "linecolor": "#767676", "showline": True, "mirror": True}


def style(number: int) -> tuple[str, str]:
    """Colour and dash of curve `number` of a plot."""
    return COLOURS[number % len(COLOURS)], DASHES[number // len(COLOURS) % len(DASHES)]


def figure_json(plot: Plot) -> str:
    """The figure as JSON that can stand inside a script element; the numbers have single precision."""
    long = sum(len(curve.x) > _LEAST_POINTS for curve in plot.curves)
    most = min(MOST_POINTS, max(_LEAST_POINTS, _POINTS_IN_PLOT // max(long, 1)))
    figure = go.Figure(
        data=[_trace(plot, curve, most, *style(i)) for i, curve in enumerate(plot.curves)],
        layout=go.Layout(
            template={},
            xaxis=_axis(plot.log_x),
            yaxis=_axis(plot.log_y) | ({"scaleanchor": "x", "scaleratio": 1} if plot.equal else {}),
            margin={"l": 8, "r": 12, "t": 12, "b": 8},
            font={"family": "system-ui, sans-serif", "size": 12, "color": "#1a1a1a"},
            paper_bgcolor="white",
            plot_bgcolor="white",
            showlegend=False,
            hovermode="closest",
            hoverlabel={"namelength": -1},
        ),
    )
    text: str = figure.to_json()
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _trace(plot: Plot, curve: Curve, most: int, colour: str, dash: str) -> go.Scatter:
    if curve.x.shape != curve.y.shape:
        raise ValueError(f"{plot.title}: curve {curve.label} has {curve.x.shape} x and {curve.y.shape} y values")
    x, y = thinned(curve.x, curve.y, most, log_x=plot.log_x)
    look: dict[str, Any] = {"mode": "lines", "line": {"color": colour, "dash": dash, "width": 1.6, "simplify": False}}
    if curve.marks:
        look = {
            "mode": "markers",
            "marker": {"color": colour, "size": 7, "symbol": "circle-open", "line": {"width": 1.6}},
        }
    return go.Scatter(x=_single(x), y=_single(y), name=html.escape(curve.label), **look)


def _single(values: Array) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Half the bytes; a screen has fewer digits still. What is too large for it becomes a gap."""
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
    return np.where(np.isfinite(single), single, np.float32(np.nan))


def _axis(log: bool) -> dict[str, Any]:
    axis = _GRID | {"automargin": True, "exponentformat": "power", "hoverformat": ".5g"}
    return axis | ({"type": "log", "minor": {"showgrid": True, "gridcolor": "#f1f1f1"}} if log else {})
