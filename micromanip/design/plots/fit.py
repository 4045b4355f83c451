"""Pictures of a fitted hysteresis model: beside its data (figure 5), residuals, held-out record, density."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from micromanip.settings.schema.hysteresis import PrandtlIshlinskii

from ..analyse.describing import inverse_operator
from ..data import Record
from ..identify.fitting import Fitted
from ..report.model import Array, Curve, Plot
from .canvas import save

_SHOWN_S = 5.0


def _times_s(record: Record) -> Array:
    return np.asarray(np.arange(len(record.u)) * record.step_s, dtype=float)


def _beside(burn_in: int, record: Record, predicted: Array) -> tuple[Plot, Plot]:
    """Model and measurement over time (the last seconds) and as a loop."""
    t_s = _times_s(record)
    late = slice(max(burn_in, len(record.u) - round(max(_SHOWN_S, 0.1 * t_s[-1]) / record.step_s)), None)
    used, pairs = slice(burn_in, None), (("measured", record.y), ("model", predicted))
    over_time, loop = (
        tuple(Curve(name, x[part], y[part]) for name, y in pairs) for x, part in ((t_s, late), (record.u, used))
    )
    return (
        Plot("", "time, s", record.output_name, over_time),
        Plot("", record.input_name, record.output_name, loop),
    )


def _residuals(burn_in: int, record: Record, predicted: Array) -> tuple[Plot, Plot]:
    """Residual over time, and over the input: what is left of the loop."""
    left, error = f"model - measured {record.output_name}", predicted - record.y
    over_time, over_input = (
        Plot("", label, left, (Curve("", x[burn_in:], error[burn_in:]),))
        for label, x in (("time, s", _times_s(record)), (record.input_name, record.u))
    )
    return over_time, over_input


def _density(model: PrandtlIshlinskii) -> tuple[Plot, Plot]:
    """Thresholds and weights, of the model and of its inverse (8)-(9)."""
    inverse = inverse_operator(model)
    forward = Curve("", np.array(model.thresholds_um), np.array(model.weights), marks=True)
    back = Curve("", np.array(inverse.thresholds), np.array(inverse.weights), marks=True)
    return (
        Plot("", "threshold r, um", "weight", (forward,)),
        Plot("", "threshold of the inverse, um", "weight of the inverse", (back,)),
    )


def draw_fit(result: Fitted, record: Record, held_out: Record | None, folder: Path) -> Iterator[Path]:
    """Draw all of them into `folder`; the files."""
    predicted, kind = result.predict(record.u), f"{result.kind}, rms {result.rms_percent:.2f} % of the stroke"
    yield save(_beside(result.burn_in, record, predicted), folder, "figure5_model", kind)
    yield save(_residuals(result.burn_in, record, predicted), folder, "residuals", kind)
    if held_out is not None and result.validation is not None:
        other = result.held_out if result.held_out is not None else result.predict(held_out.u)
        other = other - (other - held_out.y)[result.burn_in :].mean()
        what = f"not fitted to: rms {result.validation['rms_percent']:.2f} % of the stroke"
        yield save(_beside(result.burn_in, held_out, other), folder, "held_out", what)
        yield save(_residuals(result.burn_in, held_out, other), folder, "held_out_residuals", what)
    if isinstance(result.settings, PrandtlIshlinskii):
        what = "Thresholds and weights of the play operators"
        yield save(_density(result.settings), folder, "density", what)
