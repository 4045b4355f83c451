"""Prandtl-Ishlinskii models fitted to a recording by least squares, cost (14).

Thresholds ``r_i = beta i``, weights ``rho_i = gamma exp(-delta r_i)``, alpha = 1 (redundant with the scale of the
shaping), shaping affine (15) or tanh (16), as in section 4.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from micromanip.rt.hysteresis import model_output
from micromanip.rt.jit import compiled
from micromanip.rt.records import HYSTERESIS_PARAMETERS, MAX_PLAYS
from micromanip.settings.compile import fill_prandtl_ishlinskii
from micromanip.settings.hysteresis import PrandtlIshlinskii

Array = NDArray[np.float64]


@compiled
def simulate_model(p: Any, v: Any, y: Any) -> None:
    """Response `y` (um) of model (6) to the voltages `v`, plays started as (3)."""
    w = np.zeros(MAX_PLAYS)
    for k in range(len(v)):
        y[k] = model_output(p, w, v[k])


def predict(model: PrandtlIshlinskii, voltage_V: Array) -> Array:
    """Displacement (um) of `model` over `voltage_V` (n,)."""
    record = np.zeros(1, HYSTERESIS_PARAMETERS)
    fill_prandtl_ishlinskii(record[0], model, 1.0)
    y = np.empty(len(voltage_V))
    simulate_model(record[0], np.ascontiguousarray(voltage_V, dtype=float), y)
    return y


@dataclass(frozen=True)
class HysteresisFit:
    """A fitted model and how well it follows the record."""

    model: PrandtlIshlinskii
    rms_um: float
    cost: float


def _build(
    x: Array, shaping: Literal["affine", "tanh"], plays: int, range_um: tuple[float, float]
) -> PrandtlIshlinskii:
    beta, gamma, delta = np.exp(x[:3])
    r = beta * np.arange(1, plays + 1)
    coefficients: tuple[float, ...]
    if shaping == "affine":
        coefficients = (float(np.exp(x[3])), float(x[4]))
    else:
        coefficients = (float(np.exp(x[3])), float(np.exp(x[4])), float(x[5]), float(x[6]))
    return PrandtlIshlinskii(
        model="pi",
        shaping=shaping,
        coefficients=coefficients,
        thresholds_um=tuple(float(value) for value in r),
        weights=tuple(float(value) for value in gamma * np.exp(-delta * r)),
        range_um=range_um,
    )


def fit_prandtl_ishlinskii(
    voltage_V: Array,
    displacement_um: Array,
    shaping: Literal["affine", "tanh"],
    range_um: tuple[float, float],
    plays: int = 6,
    burn_in: int = 0,
) -> HysteresisFit:
    """Fit model (6) to a record, both arrays (n,); the first `burn_in` samples do not count."""
    span = float(np.ptp(voltage_V))
    slope = float(np.ptp(displacement_um)) / span
    middle = float(np.mean(voltage_V))
    start = [np.log(span * slope / (3 * plays)), np.log(0.15), np.log(3.0 / (span * slope))]
    offset = float(np.mean(displacement_um)) - slope * middle
    if shaping == "affine":
        start += [np.log(0.7 * slope), offset]
    else:
        width = 1.5 * span
        start += [
            np.log(0.7 * slope * width),
            np.log(1.0 / width),
            -middle / width,
            float(np.mean(displacement_um)) * 0.7,
        ]

    def residual(x: Array) -> Array:
        return (predict(_build(x, shaping, plays, range_um), voltage_V) - displacement_um)[burn_in:]

    solution = least_squares(residual, np.array(start), x_scale="jac", max_nfev=400)
    model = _build(solution.x, shaping, plays, range_um)
    left = residual(solution.x)
    return HysteresisFit(model, float(np.sqrt(np.mean(left**2))), float(np.sum(left**2)))
