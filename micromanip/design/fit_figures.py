"""Pictures of a fitted hysteresis model: beside its data (figure 5), residuals, held-out record, density."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from micromanip.settings.schema.hysteresis import PrandtlIshlinskii

from .canvas import panels, save
from .describing import inverse_operator
from .fitting import Fitted
from .record import Record

Array = NDArray[np.float64]

_SHOWN_S = 5.0


def _beside(result: Fitted, record: Record, predicted: Array, title: str) -> Figure:
    """Model and measurement over time (the last seconds) and as a loop."""
    used = slice(result.burn_in, None)
    figure, (top, bottom) = panels(2, title, 1.6)
    seconds = np.arange(len(record.u)) * record.step_s
    shown = slice(max(result.burn_in, len(record.u) - round(max(_SHOWN_S, 0.1 * seconds[-1]) / record.step_s)), None)
    top.plot(seconds[shown], record.y[shown], label="measured", lw=1.4)
    top.plot(seconds[shown], predicted[shown], "--", label="model", lw=1.0)
    bottom.plot(record.u[used], record.y[used], label="measured", lw=1.2, alpha=0.6, rasterized=True)
    bottom.plot(record.u[used], predicted[used], label="model", lw=0.7, rasterized=True)
    top.set(xlabel="time, s", ylabel=f"{record.output_name}")
    bottom.set(xlabel=f"{record.input_name}", ylabel=f"{record.output_name}")
    for panel in (top, bottom):
        panel.legend()
        panel.grid(alpha=0.3)
    return figure


def _residuals(result: Fitted, record: Record, error: Array, title: str) -> Figure:
    """Residual over time, and over the input: what is left of the loop."""
    used = slice(result.burn_in, None)
    figure, (top, bottom) = panels(2, title, 1.4)
    seconds = np.arange(len(record.u)) * record.step_s
    top.plot(seconds[used], error[used], lw=0.6, rasterized=True)
    bottom.plot(record.u[used], error[used], lw=0.4, rasterized=True)
    left = f"model - measured {record.output_name}"
    top.set(xlabel="time, s", ylabel=left)
    bottom.set(xlabel=f"{record.input_name}", ylabel=left)
    for panel in (top, bottom):
        panel.grid(alpha=0.3)
    return figure


def _density(model: PrandtlIshlinskii) -> Figure:
    """Thresholds and weights, of the model and of its inverse (8)-(9)."""
    inverse = inverse_operator(model)
    figure, (top, bottom) = panels(2, "Thresholds and weights of the play operators", 1.3)
    top.stem(model.thresholds_um, model.weights)
    top.set(xlabel="threshold r, um", ylabel="weight")
    bottom.stem(inverse.thresholds, inverse.weights)
    bottom.set(xlabel="threshold of the inverse, um", ylabel="weight of the inverse")
    for panel in (top, bottom):
        panel.grid(alpha=0.3)
    return figure


def draw_fit(result: Fitted, record: Record, held_out: Record | None, folder: Path, dpi: int = 130) -> list[Path]:
    """Draw all of them into `folder`; the files."""
    predicted = result.predict(record.u)
    what = f"{result.kind}, rms {result.rms_percent:.2f} % of the stroke"
    files = [save(_beside(result, record, predicted, what), folder, "figure5_model", dpi)]
    files.append(save(_residuals(result, record, predicted - record.y, what), folder, "residuals", dpi))
    if held_out is not None and result.validation is not None:
        other = result.held_out if result.held_out is not None else result.predict(held_out.u)
        other = other - (other - held_out.y)[result.burn_in :].mean()
        what = f"not fitted to: rms {result.validation['rms_percent']:.2f} % of the stroke"
        files.append(save(_beside(result, held_out, other, what), folder, "held_out", dpi))
        files.append(save(_residuals(result, held_out, other - held_out.y, what), folder, "held_out_residuals", dpi))
    if isinstance(result.settings, PrandtlIshlinskii):
        files.append(save(_density(result.settings), folder, "density", dpi))
    return files
