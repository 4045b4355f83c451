"""Prandtl-Ishlinskii model (6) with its exact sensitivities, and the loop's inverse, each in one compiled pass.

A play that slips moves with its input (derivative 1) and against its threshold (derivative -1 or +1); one that
rests keeps the derivatives it had. So forward sensitivities cost one comparison a play and sample, and the gradient
with respect to any parametrisation of shaping, thresholds and weights follows by the chain rule.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from micromanip.control.system import Array
from micromanip.rt.jit import Compiler
from micromanip.rt.laws.feedforward import (
    HYSTERESIS_PARAMETERS,
    HYSTERESIS_STATE,
    feedforward_voltage,
    start_feedforward,
)
from micromanip.settings.compile.hysteresis import fill_hysteresis
from micromanip.settings.schema.hysteresis import Network, PrandtlIshlinskii

compiled = Compiler(__file__, allocates=True)


@compiled
def lag_columns(x: Any, step: float, lagged: Any) -> None:
    """Fill `lagged` (n, k) with ``x`` (n, k) behind a first-order lag of `step` per sample, one sample late."""
    samples, columns = x.shape
    deviation = np.zeros(columns)
    for j in range(columns):
        lagged[0, j] = x[0, j]
    for k in range(1, samples):
        for j in range(columns):
            deviation[j] = step * (x[k - 1, j] - x[0, j]) - (step - 1.0) * deviation[j]
            lagged[k, j] = deviation[j] + x[0, j]


@compiled
def _plays(
    u: Any,
    du: Any,
    speed_step: float,
    kappa: float,
    r: Any,
    rho: Any,
    start: float,
    dstart: Any,
    y: Any,
    by_shape: Any,
    by_threshold: Any,
    states: Any,
    by_kappa: Any,
    by_start: Any,
) -> None:
    """Fill outputs and derivatives, a row per sample; see ``Sensitivities``."""
    samples, shapes = du.shape
    plays = len(r)
    w = np.full(plays, start)
    dw = np.zeros((plays, shapes))
    for j in range(shapes):
        dw[:, j] = dstart[j]
    kept = np.ones(plays)
    dr = np.zeros(plays)
    dk = np.zeros(plays)
    for k in range(samples):
        change = u[k] - u[k - 1] if k > 0 else 0.0
        speed = abs(change) / speed_step
        sign = 1.0 if change > 0.0 else -1.0
        total = u[k]
        kappa_total = 0.0
        start_total = 0.0
        for j in range(shapes):
            by_shape[k, j] = du[k, j]
        for i in range(plays):
            threshold = r[i] + kappa * speed
            side = 0.0
            if w[i] < u[k] - threshold:
                side = 1.0
            elif w[i] > u[k] + threshold:
                side = -1.0
            if side != 0.0:
                w[i] = u[k] - side * threshold
                dr[i] = -side
                kept[i] = 0.0
                dk[i] = -side * speed
                for j in range(shapes):
                    widened = sign * (du[k, j] - du[k - 1, j]) / speed_step if k > 0 else 0.0
                    dw[i, j] = du[k, j] - side * kappa * widened
            total += rho[i] * w[i]
            states[k, i] = w[i]
            by_threshold[k, i] = rho[i] * dr[i]
            kappa_total += rho[i] * dk[i]
            start_total += rho[i] * kept[i]
            for j in range(shapes):
                by_shape[k, j] += rho[i] * dw[i, j]
        y[k] = total
        by_kappa[k] = kappa_total
        by_start[k] = start_total


@dataclass(frozen=True)
class Sensitivities:
    """Output (n,) of the model and its derivatives, a row per sample.

    ``by_shape`` (n, shapes) with respect to the shaping's parameters, ``by_threshold`` (n, plays),
    ``states`` (n, plays) the play outputs, which are the derivatives by the weights, ``by_kappa`` (n,),
    ``by_start`` (n,) with respect to where the plays were before the first sample.
    """

    y: Array
    by_shape: Array
    by_threshold: Array
    states: Array
    by_kappa: Array
    by_start: Array


def respond(
    u: Array,
    du: Array,
    r: Array,
    rho: Array,
    kappa: float = 0.0,
    step_s: float = 1.0,
    start: float = 0.0,
    dstart: Array | None = None,
) -> Sensitivities:
    """Response to the shaped input `u` (n,), with `du` (n, shapes) its derivatives.

    All plays were at `start`, with derivatives `dstart` (shapes,), before the first sample: (3) has 0. `kappa` (s)
    widens every threshold by kappa times the speed of u, at a sampling of `step_s`.
    """
    n, plays = len(u), len(r)
    tables = np.empty(du.shape), np.empty((n, plays)), np.empty((n, plays))
    result = Sensitivities(np.empty(n), *tables, np.empty(n), np.empty(n))
    _plays(
        u,
        du,
        step_s,
        kappa,
        r,
        rho,
        start,
        np.zeros(du.shape[1]) if dstart is None else dstart,
        result.y,
        result.by_shape,
        result.by_threshold,
        result.states,
        result.by_kappa,
        result.by_start,
    )
    return result


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
