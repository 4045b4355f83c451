"""From an axis' hysteresis model to the record of its inverse."""

from __future__ import annotations

import functools
import hashlib
import math
from typing import Any

import numpy as np

from micromanip.rt.laws import feedforward as law
from micromanip.rt.laws.hysteresis import AFFINE, IDENTITY, TABLE, TANH, inverse_parameters
from micromanip.settings.schema.actuator import Actuator
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.hysteresis import Hysteresis, Network, NoModel, PrandtlIshlinskii

_SHAPINGS = {"identity": IDENTITY, "affine": AFFINE, "tanh": TANH, "table": TABLE}
_SWEEP_MARGIN = 1.3
"""The amplitude has fallen a little when the sweep first reaches its peak."""
_SWEEP_SHARE = 0.25


def sweep_um(axis: Axis) -> float:
    """Amplitude of the decaying sweep that wipes the memory of the axis' hysteresis model."""
    model = axis.hysteresis
    if isinstance(model, PrandtlIshlinskii):
        h = np.zeros(1, law.HYSTERESIS_PARAMETERS)[0]
        fill_prandtl_ishlinskii(h, model, 1e-4)
        return _SWEEP_MARGIN * float(h["r_hat"][: h["plays"]].max(initial=0.0))
    return 0.0 if isinstance(model, NoModel) else _SWEEP_SHARE * (model.range_um[1] - model.range_um[0])


def fill_hysteresis(h: Any, model: Hysteresis, period_s: float, actuator: Actuator | None = None) -> None:
    """Fill a HYSTERESIS_PARAMETERS record from `model`, and from the linear dynamics around it."""
    h["kind"] = law.NONE
    if isinstance(model, NoModel):
        return
    h["low_um"], h["high_um"] = model.range_um
    if isinstance(model, Network):
        n = len(model.input_weights)
        h["kind"], h["neurons"] = law.NETWORK, n
        h["reversal_um"] = model.reversal_um
        h["w_in"][:n], h["b_in"][:n] = model.input_weights, model.input_biases
        h["w_out"][:n], h["b_out"] = model.output_weights, model.output_bias
    else:
        fill_prandtl_ishlinskii(h, model, period_s)
    if actuator is not None:
        _fill_dynamics(h, actuator, period_s)
    h["identity"] = int.from_bytes(hashlib.blake2b(h.tobytes(), digest_size=8).digest(), "little", signed=True)


def _fill_dynamics(h: Any, actuator: Actuator, period_s: float) -> None:
    h["resonances"] = len(actuator.resonances)
    for i, each in enumerate(actuator.resonances):
        tangent = math.tan(math.pi * each.antiresonance_Hz * period_s)
        ratio = math.tan(math.pi * each.resonance_Hz * period_s) / tangent
        h["zero_tangent"][i], h["zero_width"][i] = tangent, 2.0 * each.antiresonance_damping
        h["pole_band"][i], h["pole_high"][i] = 2.0 * each.resonance_damping / ratio, ratio**-2
    if actuator.lag_us is not None:
        # exact for a voltage that is held from cycle to cycle, and a cycle late
        passed = period_s / (1e-6 * actuator.lag_us)
        h["lead"] = -math.exp(-passed) / math.expm1(-passed)


def fill_prandtl_ishlinskii(h: Any, model: PrandtlIshlinskii, period_s: float) -> None:
    """Fill model and inverse (8)-(9), creep and rate dependence per step of `period_s`."""
    n = len(model.thresholds_um)
    h["kind"], h["plays"], h["alpha"] = law.PRANDTL_ISHLINSKII, n, model.alpha
    h["r"][:n], h["rho"][:n] = model.thresholds_um, model.weights
    shaping = h["shaping"]
    shaping["kind"] = _SHAPINGS[model.shaping]
    shaping["c"][: len(model.coefficients)] = model.coefficients
    points = len(model.table_V)
    shaping["points"] = points
    shaping["v"][:points], shaping["u"][:points] = model.table_V, model.table_um
    h["rate_cycles"] = model.rate_ms * 1e-3 / period_s
    creeps = len(model.creep_s)
    h["creeps"] = creeps
    h["creep_gain"][:creeps] = model.creep_gains
    h["creep_step"][:creeps] = -np.expm1(-period_s / np.array(model.creep_s, dtype=float))
    h["r_hat"], h["rho_hat"] = _inverse(model)


@functools.lru_cache(32)
def _inverse(model: PrandtlIshlinskii) -> tuple[Any, Any]:
    """Thresholds and weights of the inverse; plain Python here, and asked for again with every change of a tuning."""
    h, n = np.zeros(1, law.HYSTERESIS_PARAMETERS)[0], len(model.thresholds_um)
    h["plays"], h["alpha"], h["r"][:n], h["rho"][:n] = n, model.alpha, model.thresholds_um, model.weights
    inverse_parameters(h)
    return h["r_hat"], h["rho_hat"]
