"""The preview of one axis as a picture: what the actuator is asked for, and the path error that is left."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from micromanip.design.canvas import panels, save
from micromanip.settings.schema.axis import Axis

from .preview import AxisPreview
from .stretches import ERROR

_MOST = 20_000
"""Points a line: more are not seen, and make large files."""


def draw_preview(axis: AxisPreview, left: AxisPreview, settings: Axis, folder: Path, about: str = "") -> Iterator[Path]:
    """Write the picture of one axis, with and without the robot's offset, into `folder`, as PNG and SVG; the files."""
    verdict = "fits" if not axis.stretches else f"asks {len(axis.stretches)} times for more than there is"
    figure, (path, setpoint, error) = panels(3, f"Preview of axis {axis.axis}: {verdict}", 1.7)
    time_s = np.arange(len(axis.predicted.setpoint_um)) / axis.predicted.rate_Hz
    shown = slice(None, None, max(1, len(time_s) // _MOST))
    for found, label, width in ((axis.predicted, "as it is", 1.2), (left.predicted, "with the robot's offset", 0.8)):
        path.plot(time_s[shown], found.deviation_um[shown], lw=width, label=label)
        setpoint.plot(time_s[shown], found.setpoint_um[shown], lw=width)
        error.plot(time_s[shown], found.error_um[shown], lw=width)
    for limit in settings.setpoint.range_um:
        setpoint.axhline(limit, color="k", linestyle=":")
    for sign in (-1.0, 1.0):
        error.axhline(sign * axis.tolerance_um, color="k", linestyle=":")
    for stretch in axis.stretches:
        panel = error if stretch.what == ERROR else setpoint
        panel.axvspan(stretch.from_s, stretch.to_s, color="tab:red", alpha=0.2, lw=0)
    path.set(ylabel="deviation, um")
    path.legend(fontsize="small", frameon=False)
    setpoint.set(ylabel="set-point, um")
    error.set(ylabel="following error, um", xlabel="s of the path")
    yield save(figure, folder, f"preview_{axis.axis}", about=about)
