"""The inverse of a model as the loop runs it, over whole arrays; signals about zero."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.laws.feedforward import (
    HYSTERESIS_PARAMETERS,
    HYSTERESIS_STATE,
    feedforward_voltage,
    start_feedforward,
)
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
def _invert(p: Any, s: Any, y: Any, v0: float, v: Any) -> None:
    start_feedforward(p, s, y[0], v0)
    for k in range(len(y)):
        v[k] = feedforward_voltage(p, s, y[k])


def inverse(
    model: PrandtlIshlinskii | Network, displacement_um: Array, step_s: float = 1e-4, start_V: float = 0.0
) -> Array:
    """Voltage (n,) that the loop's feedforward gives for `displacement_um` (n,), taken over at `start_V`."""
    v, state, record = np.empty(len(displacement_um)), np.zeros(1, HYSTERESIS_STATE), np.zeros(1, HYSTERESIS_PARAMETERS)
    fill_hysteresis(record[0], model, step_s)
    _invert(record[0], state[0], np.ascontiguousarray(displacement_um, dtype=float), start_V, v)
    return v
