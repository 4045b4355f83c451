"""Response of a model from the configuration, and of its inverse as the loop runs it, to whole arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.laws.feedforward import (
    HYSTERESIS_PARAMETERS,
    HYSTERESIS_STATE,
    MAX_CREEP,
    feedforward_voltage,
    start_feedforward,
)
from micromanip.rt.laws.hysteresis import MAX_PLAYS, play
from micromanip.rt.laws.shaping import shape
from micromanip.settings.compile.hysteresis import fill_hysteresis
from micromanip.settings.schema.hysteresis import Network, PrandtlIshlinskii

from .kernel import compiled

# A search for the best model takes another way where rounding differs, and may end elsewhere. So that nothing it finds
# depends on where a sensor has its zero, it sees numbers that are the same, to the last bit, wherever that is.

_GRID = 2.0**24


def span(signal: Array) -> tuple[float, float]:
    """Middle and half width of a signal (n,), the width to 24 bits."""
    low, high = float(signal.min()), float(signal.max())
    return 0.5 * (low + high), float(np.float32(0.5 * (high - low)))


def about_zero(signal: Array, middle: float, half: float) -> Array:
    """`signal` (n,) less `middle`, in steps of 2^-24 of `half`."""
    return np.asarray(np.rint((signal - middle) / half * _GRID) / _GRID * half)


Array = NDArray[np.float64]


@compiled
def _respond(p: Any, v: Any, y: Any) -> None:
    w = np.zeros(MAX_PLAYS)
    creep = np.zeros(MAX_CREEP)
    before = shape(p["shaping"], v[0])
    creep[:] = before
    for k in range(len(v)):
        u = shape(p["shaping"], v[k])
        widening = p["rate_cycles"] * abs(u - before)
        before = u
        total = p["alpha"] * u
        for i in range(p["plays"]):
            w[i] = play(u, p["r"][i] + widening, w[i])
            total += p["rho"][i] * w[i]
        for m in range(p["creeps"]):
            total += p["creep_gain"][m] * creep[m]
            creep[m] += p["creep_step"][m] * (u - creep[m])
        y[k] = total


@compiled
def _invert(p: Any, s: Any, y: Any, v0: float, v: Any) -> None:
    start_feedforward(p, s, y[0], v0)
    for k in range(len(y)):
        v[k] = feedforward_voltage(p, s, y[k])


def _record(model: PrandtlIshlinskii | Network, step_s: float) -> Any:
    record = np.zeros(1, HYSTERESIS_PARAMETERS)
    fill_hysteresis(record[0], model, step_s)
    return record[0]


def predict(model: PrandtlIshlinskii, voltage_V: Array, step_s: float = 1e-3) -> Array:
    """Displacement (n,) in um of `model` over `voltage_V` (n,) sampled at `step_s`; plays start as (3).

    The sampling matters for creep and rate dependence only.
    """
    y = np.empty(len(voltage_V))
    _respond(_record(model, step_s), np.ascontiguousarray(voltage_V, dtype=float), y)
    return y


def inverse(
    model: PrandtlIshlinskii | Network, displacement_um: Array, step_s: float = 1e-4, start_V: float = 0.0
) -> Array:
    """Voltage (n,) that the loop's feedforward gives for `displacement_um` (n,), taken over at `start_V`."""
    v = np.empty(len(displacement_um))
    state = np.zeros(1, HYSTERESIS_STATE)
    _invert(_record(model, step_s), state[0], np.ascontiguousarray(displacement_um, dtype=float), start_V, v)
    return v
