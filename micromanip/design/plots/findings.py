"""Plots of a fit, and of what `analyse` finds beside margins: a path, a running loop."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from micromanip.control.system import Array
from micromanip.recordings import TimeSeries
from micromanip.settings.schema.axis import Axis

from ..analyse.live_margins import Running
from ..analyse.path.preview import ERROR, AxisPreview, Preview
from ..identify.fitting import Fitted
from ..report.model import Curve, Plot, Section

_SHOWN_S = 5.0


def _beside(burn_in: int, record: TimeSeries, predicted: Array) -> tuple[Plot, Plot]:
    """Model and measurement over time (the last seconds) and as a loop."""
    t_s = record.time_s
    late = slice(max(burn_in, len(record.u) - round(max(_SHOWN_S, 0.1 * t_s[-1]) / record.step_s)), None)
    used, pairs = slice(burn_in, None), (("measured", record.y), ("model", predicted))
    over_time, loop = (
        tuple(Curve(name, x[part], y[part]) for name, y in pairs) for x, part in ((t_s, late), (record.u, used))
    )
    return (
        Plot("Model and data", "time, s", record.names[1], over_time),
        Plot("As a loop", record.names[0], record.names[1], loop),
    )


def _residuals(burn_in: int, record: TimeSeries, predicted: Array) -> tuple[Plot, Plot]:
    """Residual over time, and over the input: what is left of the loop."""
    left, error = f"model - measured {record.names[1]}", predicted - record.y
    over_time, over_input = (
        Plot("What is left", label, left, (Curve("", x[burn_in:], error[burn_in:]),))
        for label, x in (("time, s", record.time_s), (record.names[0], record.u))
    )
    return over_time, over_input


def fit_sections(result: Fitted, record: TimeSeries, held_out: TimeSeries | None) -> Iterator[Section]:
    """Model beside data and what is left, of the record and of the one that was not fitted to."""
    kind = f"{result.kind}, rms {result.rms_percent:.2f} % of the stroke."
    predicted = result.predict(record.u)
    yield _fit_section("The record", kind, result.burn_in, record, predicted)
    if held_out is not None and result.validation is not None:
        other = result.held_out if result.held_out is not None else result.predict(held_out.u)
        other = other - (other - held_out.y)[result.burn_in :].mean()
        kind = f"Not fitted to: rms {result.validation['rms_percent']:.2f} % of the stroke."
        yield _fit_section("Another record", kind, result.burn_in, held_out, other)


def _fit_section(title: str, text: str, burn_in: int, record: TimeSeries, predicted: Array) -> Section:
    plots = (*_beside(burn_in, record, predicted), *_residuals(burn_in, record, predicted))
    return Section(title, text, {}, plots)


def preview_sections(found: Preview, axes: Mapping[str, Axis], about: str) -> Iterator[Section]:
    """Each axis on the path; `about` says where it comes from."""
    for axis in found.axes:
        yield Section(f"Axis {axis.axis}", about, {}, preview_plots(axis, axes[axis.axis]))


_FAR = 2.5
"""The Nyquist curve is shown so far from the origin."""


def preview_plots(axis: AxisPreview, settings: Axis) -> tuple[Plot, ...]:
    """One axis on its path; where it is asked for more than there is."""
    verdict = "fits" if not axis.stretches else f"asks {len(axis.stretches)} times for more than there is"
    found, time_s = axis.predicted, np.arange(len(axis.predicted.setpoint_um)) / axis.predicted.rate_Hz
    panels = (
        ("deviation_um", f"Preview of axis {axis.axis}: {verdict}", "deviation, um", ()),
        ("setpoint_um", "Set-point", "set-point, um", settings.setpoint.range_um),
        ("error_um", "Following error", "following error, um", (-axis.tolerance_um, axis.tolerance_um)),
    )
    plots = []
    for name, title, label, limits in panels:
        curves = [Curve("predicted", time_s, getattr(found, name))]
        curves += [_levels("limit", time_s, *limits)] if limits else []
        over = np.zeros(len(time_s), dtype=bool)
        for stretch in axis.stretches:
            if name == ("error_um" if stretch.what == ERROR else "setpoint_um"):
                over |= (time_s >= stretch.from_s) & (time_s <= stretch.to_s)
        if over.any():
            curves.append(Curve("more than there is", time_s, np.where(over, getattr(found, name), np.nan)))
        plots.append(Plot(title, "s of the path", label, tuple(curves)))
    return tuple(plots)


def _levels(label: str, x: Array, *values: float) -> Curve:
    """Level lines, with a gap between them."""
    y = np.repeat(np.array(values, dtype=float), 3)
    y[2::3] = np.nan
    return Curve(label, np.tile([x[0], x[-1], np.nan], len(values)), y, faint=True)


def running_plots(found: Running) -> tuple[Plot, Plot]:
    """|S| at the measured lines with its confidence, and L around -1; predictions beside them where there are any."""
    lines = found.loop
    hertz, L, near = lines.frequency_Hz, lines.measured, np.abs(1.0 + lines.measured)
    highest = max(found.measured[found.nominal].sensitivity, 1.0)
    bounds = np.concatenate([near + 2.0 * lines.deviation, [np.nan], np.maximum(near - 2.0 * lines.deviation, 0.05)])
    sizes = [Curve("measured", hertz, 1.0 / near, marks=True)]
    sizes.append(Curve("two standard deviations", np.concatenate([hertz, [np.nan], hertz]), 1.0 / bounds, faint=True))
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 200))
    around = [_shown("measured", L, marks=True), _shown(f"Ms {highest:.2f}", turn / highest - 1.0, faint=True)]
    if found.predicted is not None:
        between = np.geomspace(hertz[0], hertz[-1], 2000)
        predicted = lines.model(2 * np.pi * between)
        sizes.append(Curve("predicted", between, 1.0 / np.abs(1.0 + predicted)))
        around.append(_shown("predicted", predicted))
    around.append(_shown("-1", np.array([-1.0 + 0.0j]), marks=True))
    title = f"Axis {found.axis}, {lines.name}: measured while it runs"
    return (
        Plot(title, "frequency, Hz", "|S|", tuple(sizes), log_x=True, log_y=True),
        Plot("Nyquist", "Re L", "Im L", tuple(around), equal=True),
    )


def _shown(label: str, L: np.ndarray, *, marks: bool = False, faint: bool = False) -> Curve:
    near = np.abs(L) < _FAR
    return Curve(label, np.where(near, L.real, np.nan), np.where(near, L.imag, np.nan), marks, faint)
