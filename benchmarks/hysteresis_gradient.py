"""Fitting a hysteresis model: cost and Jacobian beside loops in NumPy with finite differences.

The record is the simulated actuator under the multisine, 120,000 samples. The reference walks through the samples
in Python, NumPy works on all plays at once, and every parameter costs one more walk. It is measured on a
stretch and scaled to the whole record. Both kinds of derivatives must lead a fit to the same cost.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from micromanip.design.hysteresis import fit, structure_of
from micromanip.design.hysteresis.structure import Structure
from micromanip.design.identification import design, samples_for, variant
from micromanip.errors import CheckFailed
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

from .plan import Plan
from .results import Result

Array = NDArray[np.float64]

_SAMPLES, _RATE_HZ, _PLAYS = 120_000, 1000, 10
_STRETCH, _THINNED = 2_400, 80
_FORWARD_STEP = 1e-7
_STARTS, _EVALUATIONS = 3, 60
_FIT_LIMIT_S = 10.0
_SAME_COST = 0.01


def run(plan: Plan) -> list[Result]:
    """Evaluations a second, seconds for a whole fit, and the cost reached; CheckFailed where the costs disagree."""
    plan.tell(f"hysteresis: recording {_SAMPLES} samples in virtual time")
    v, y = _record(plan)
    structure = structure_of("pi-tanh", v, 1.0 / _RATE_HZ, _PLAYS)
    x = structure.start(y, np.random.default_rng(0), 0.0)
    ours, reference = _evaluation(structure, x, v, y)
    plan.tell("hysteresis: fitting")
    begin = time.perf_counter()
    fitted = fit(structure, v, y, (float(y.min()), float(y.max())), _RATE_HZ)
    fit_s = time.perf_counter() - begin
    plan.tell(f"hysteresis: {fitted.rms_percent:.3f} % rms; fitting every {_THINNED}th sample with both gradients")
    reached, reached_loops = _costs(structure, v[::_THINNED].copy(), y[::_THINNED].copy())
    return [
        Result.of("hysteresis_gradient", 1.0 / ours, "1/s", "NumPy loops, forward differences", 1.0 / reference),
        Result.of("hysteresis_fit", fit_s, "s", "limit", _FIT_LIMIT_S),
        Result.of("hysteresis_cost", reached, "um2", "NumPy loops, forward differences", reached_loops),
    ]


def _record(plan: Plan) -> tuple[Array, Array]:
    """Voltage and measured displacement, 1 kHz, of the first axis."""
    prepared = prepare(plan.configuration)
    configuration = prepared.configuration
    axis, every = next(iter(configuration.axes)), configuration.loop.rate_hz // _RATE_HZ
    excitation = design(configuration, axis, "multisine", _SAMPLES / _RATE_HZ, seed=1)
    seconds = len(excitation.samples) / configuration.loop.rate_hz
    rows = VirtualExperiment(prepared)(
        variant(configuration), seconds, samples_for(configuration, excitation), every=every
    )
    used = rows["axis"][excitation.lead_cycles // every :][:_SAMPLES]
    return used["voltage_V"][:, 0].copy(), used["strain_um"][:, 0].copy()


def _loops(structure: Structure, x: Array, v: Array) -> Array:
    """Displacement (n,) of the tanh model (6), (16) by a loop over the samples."""
    u = structure.shaping.value(x[:4], v)[0]
    r = np.exp(x[4]) * np.arange(1, structure.plays + 1)
    rho = np.exp(x[5]) * np.exp(-(x[6] ** 2) * r)
    w, out = np.zeros(structure.plays), np.empty(len(v))
    for k in range(len(v)):
        w = np.maximum(u[k] - r, np.minimum(u[k] + r, w))
        out[k] = u[k] + rho @ w
    return out


def _differences(structure: Structure, x: Array, v: Array) -> tuple[Array, Array]:
    """Displacement and forward differences (n, parameters): one walk a parameter, and one more."""
    at = _loops(structure, x, v)
    columns = []
    for j in range(len(x)):
        moved = x.copy()
        moved[j] += _FORWARD_STEP * max(1.0, abs(x[j]))
        columns.append((_loops(structure, moved, v) - at) / (moved[j] - x[j]))
    return at, np.column_stack(columns)


def _evaluation(structure: Structure, x: Array, v: Array, y: Array) -> tuple[float, float]:
    """Seconds of cost and Jacobian on the whole record, ours and the loops' (scaled); both costs are compared."""
    stretch = v[:_STRETCH]
    ours_stretch, loops_stretch = structure.value(x, stretch), _differences(structure, x, stretch)
    _require_same("cost", _cost(ours_stretch[0], y[:_STRETCH]), _cost(loops_stretch[0], y[:_STRETCH]), 1e-9)
    ours = _seconds(lambda: structure.value(x, v), 7)
    loops = _seconds(lambda: _differences(structure, x, stretch), 3)
    return ours, loops * len(v) / len(stretch)


def _costs(structure: Structure, v: Array, y: Array) -> tuple[float, float]:
    """Lowest cost that fits from the same starts reach, with our Jacobian and with differences."""
    coarse = replace(structure, step_s=structure.step_s * _THINNED)
    rng = np.random.default_rng(0)
    starts = [structure.start(y, rng, float(k > 0)) for k in range(_STARTS)]
    best = [
        min(_reached(evaluate, start, y) for start in starts)
        for evaluate in (lambda x: coarse.value(x, v), lambda x: _differences(coarse, x, v))
    ]
    _require_same("cost of the fit", best[0], best[1], _SAME_COST)
    return best[0], best[1]


def _reached(evaluate: Callable[[Array], tuple[Array, Array]], start: Array, y: Array) -> float:
    """Cost of a fit from `start`; `evaluate` gives displacement and Jacobian."""

    def residual(x: Array) -> Array:
        return evaluate(x)[0] - y

    def jacobian(x: Array) -> Array:
        return evaluate(x)[1]

    solution = least_squares(residual, start, jac=jacobian, x_scale="jac", max_nfev=_EVALUATIONS, method="lm")
    return float(solution.cost)


def _cost(predicted: Array, y: Array) -> float:
    """Equation (14)."""
    return 0.5 * float(np.sum((predicted - y) ** 2))


def _require_same(what: str, ours: float, loops: float, tolerance: float) -> None:
    if abs(ours - loops) > tolerance * loops:
        raise CheckFailed(f"hysteresis: the {what} is {ours:.9g} by our derivatives, {loops:.9g} by differences")


def _seconds(evaluate: Callable[[], object], repeats: int) -> float:
    """Median processor time of one call."""
    evaluate()
    taken = []
    for _ in range(repeats):
        begin = time.thread_time()
        evaluate()
        taken.append(time.thread_time() - begin)
    return float(np.median(taken))
