"""A trip as a picture: errors and voltages over the whole time, and close to the trip; states shaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from .box import Box
from .evidence import error_um, milliseconds, parameters_of
from .report import states

_SIZE, _DPI = (9.0, 9.0), 130
_NEAR_MS = (-50.0, 50.0)
_SHADES = {
    "READY": "white",
    "ARMING": "tab:olive",
    "TRACKING": "tab:green",
    "HOLDING": "tab:orange",
    "RAMPING": "gold",
    "FAULT": "tab:red",
    "OFF": "tab:grey",
}


def draw(box: Box) -> Figure:
    """Four panels: errors, voltages with their range, and both near the trip."""
    figure = Figure(figsize=_SIZE, layout="constrained")
    figure.suptitle(f"{box.trip['code']}  {box.meta['utc']}")
    panels = figure.subplots(4, 1)
    ms = milliseconds(box)
    whole = (float(ms[0]), float(ms[-1]))
    near = (max(whole[0], _NEAR_MS[0]), min(whole[1], _NEAR_MS[1]))
    for panel, span in zip(panels, (whole, whole, near, near), strict=True):
        _shade(panel, box, span)
        panel.axvline(0.0, color="tab:red", lw=1.0)
        panel.set_xlim(*span)
        panel.grid(alpha=0.3)
    for i, name in enumerate(box.meta["axes"]):
        colour = f"C{i}"
        error, voltage = error_um(box, i), box.rows["axis"]["voltage_V"][:, i]
        limiter = parameters_of(box, i)["limiter"]
        for panel in (panels[0], panels[2]):
            panel.plot(ms, error, lw=0.8, color=colour, label=name)
        for panel in (panels[1], panels[3]):
            panel.plot(ms, voltage, lw=0.8, color=colour, label=name)
            for end in (limiter["low_V"], limiter["high_V"]):
                panel.axhline(end, color=colour, lw=0.8, ls="--")
    for panel, span in ((panels[0], whole), (panels[2], near)):
        panel.set_ylabel("error, um")
        _fit(panel, box, span)
    for panel in (panels[1], panels[3]):
        panel.set_ylabel("voltage, V")
    panels[3].set_xlabel("time from the trip, ms")
    panels[0].legend(loc="upper left", fontsize="small", title="axis")
    return figure


def save(box: Box, file: Path) -> None:
    """Draw the trip into a PNG or SVG file."""
    draw(box).savefig(file, dpi=_DPI, metadata={"Date": None} if file.suffix == ".svg" else None)


def _shade(panel: Any, box: Box, span: tuple[float, float]) -> None:
    """States as coloured stretches with their names."""
    begun = states(box)
    ends = [*(ms for ms, _ in begun[1:]), span[1]]
    for (begin, name), end in zip(begun, ends, strict=True):
        left, right = max(begin, span[0]), min(end, span[1])
        if right > left:
            panel.axvspan(left, right, color=_SHADES.get(name, "white"), alpha=0.15, lw=0)
            if right - left > 0.06 * (span[1] - span[0]):
                panel.annotate(
                    name,
                    ((left + right) / 2, 0.97),
                    xycoords=("data", "axes fraction"),
                    ha="center",
                    va="top",
                    fontsize="x-small",
                )


def _fit(panel: Any, box: Box, span: tuple[float, float]) -> None:
    """The height shows the errors up to shortly after the trip; what the ramp leaves behind may run out of it."""
    ms = milliseconds(box)
    shown = (ms >= span[0]) & (ms <= min(span[1], 5.0))
    worst = 0.0
    for i in range(len(box.meta["axes"])):
        error = np.abs(error_um(box, i)[shown])
        if np.isfinite(error).any():
            worst = max(worst, float(np.nanmax(error)))
    if worst > 0.0:
        panel.set_ylim(-1.2 * worst, 1.2 * worst)
