"""Actuator model (6) and its inverse (7) as one operator: shaping, plays, shaping, over a steady sine.

Both are ``output = after(gain u + sum_i weight_i G_i[u])`` with ``u = before(input)``: the model shapes before the
plays, its inverse after them. The shaping functions are those of the loop itself. What depends on speed or time
(rate dependence, creep) is left out: a describing function is that of the rate-independent part.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.jit import Compiler
from micromanip.rt.laws.feedforward import HYSTERESIS_PARAMETERS
from micromanip.rt.laws.shaping import shape, unshape
from micromanip.settings.compile.hysteresis import fill_prandtl_ishlinskii
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii, phi_range

Array = NDArray[np.float64]

compiled = Compiler(__file__, allocates=True)


@compiled
def _shape_all(p: Any, x: Any, y: Any) -> None:
    for k in range(len(x)):
        y[k] = shape(p, x[k])


@compiled
def _unshape_all(p: Any, x: Any, y: Any) -> None:
    for k in range(len(x)):
        y[k] = unshape(p, x[k])


@dataclass(frozen=True)
class Operator:
    """Plays between two monotone maps; thresholds and weights (n,), `u_limits` the values the plays' sum may take."""

    gain: float
    thresholds: Array
    weights: Array
    shaping: Any
    inverse: bool
    u_limits: tuple[float, float]

    def before(self, x: Array) -> Array:
        """The plays' input for the operator's input `x`, elementwise."""
        return x if self.inverse else self._mapped(_shape_all, x)

    def before_inverse(self, u: Array) -> Array:
        """The operator's input at which the plays see `u`."""
        return u if self.inverse else self._mapped(_unshape_all, u)

    def after(self, total: Array) -> Array:
        """The operator's output for the sum `total` of the plays."""
        return self._mapped(_unshape_all, total) if self.inverse else total

    @property
    def knots(self) -> Array:
        """Corners of a table shaping: values of the operator's input (model) or of the plays' sum (inverse)."""
        points = int(self.shaping["points"])
        return np.array(self.shaping["u" if self.inverse else "v"][:points])

    def total(self, u: Array, w: Array) -> Array:
        """``gain u + sum weight_i w_i`` for inputs `u` (k,) and play outputs `w` (k, n)."""
        return self.gain * u + w @ self.weights

    def _mapped(self, mapping: Any, x: Array) -> Array:
        flat = np.ascontiguousarray(x, dtype=float).ravel()
        y = np.empty_like(flat)
        mapping(self.shaping, flat, y)
        return y.reshape(np.shape(x))

    def swing(self, centre: float, amplitude: float) -> tuple[float, float, Array, Array]:
        """Ends of u and the plays' outputs (n,) there, in the steady state of a sine begun at rest by (3)."""
        u0, u_low, u_high = self.before(np.array([centre, centre - amplitude, centre + amplitude]))
        w = np.zeros(len(self.thresholds))
        for u in (u0, u_high, u_low):
            w = _moved(u, self.thresholds, w)
        return float(u_low), float(u_high), w, _moved(u_high, self.thresholds, w)


def _moved(u: float, r: Array, w: Array) -> Array:
    return np.maximum(u - r, np.minimum(u + r, w))


def inverse_operator(model: PrandtlIshlinskii) -> Operator:
    """The feedforward (7): displacement (um) to voltage (V)."""
    p = _filled(model)
    n = int(p["plays"])
    return Operator(
        1.0 / model.alpha, p["r_hat"][:n].copy(), p["rho_hat"][:n].copy(), p["shaping"], True, phi_range(model)
    )


def actuator_operator(model: PrandtlIshlinskii) -> Operator:
    """The model of the actuator (6): voltage (V) to displacement (um)."""
    p = _filled(model)
    n = int(p["plays"])
    return Operator(model.alpha, p["r"][:n].copy(), p["rho"][:n].copy(), p["shaping"], False, (-np.inf, np.inf))


def _filled(model: PrandtlIshlinskii) -> Any:
    record = np.zeros(1, HYSTERESIS_PARAMETERS)
    # the period matters for creep and rate dependence only, which are left out
    fill_prandtl_ishlinskii(record[0], model, 1e-4)
    return record[0]


__all__ = ["Operator", "actuator_operator", "inverse_operator"]
