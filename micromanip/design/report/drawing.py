"""A plot of the evidence as data for the page's own script, which draws it as SVG, as wide as the screen allows.

Coordinates are given as they are seen (logarithms on a logarithmic axis), in 16 bits of the plot's extent: a screen
shows fewer. Title, legend, labels and note are HTML around the drawing, where they wrap on a phone and are read aloud.
"""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .model import Array, Curve, Plot
from .thinning import thinned

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
