"""Inputs, direct term and initial states by linear least squares; output-error refinement of everything.

With the poles known the output is linear in B, D and the initial states. A few Gauss-Newton steps on the simulated
output then polish poles, B, C and D together. Normal equations are added up experiment by experiment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .modal import Array, Complex, Modes
from .subspace import Experiment

_DAMPING, _DAMPING_LIMIT = 1e-3, 1e6


def _split(values: Complex, weights: Array) -> Array:
    """Columns of a complex regressor (n, l, k, ..) as real ones: real parts, and minus imaginary of the pairs."""
    flat = (values * weights.reshape(1, 1, -1, *([1] * (values.ndim - 3)))).reshape(*values.shape[:2], -1)
    pairs = np.broadcast_to((weights == 2.0).reshape(-1, *([1] * (values.ndim - 3))), values.shape[2:]).ravel()
    real: Array = np.concatenate([flat.real, -flat.imag[:, :, pairs]], axis=2)
    return real


def _join(parameters: Array, weights: Array, shape: tuple[int, ...]) -> Complex:
    """Inverse of the order of `_split`: real parameters to complex values of `shape` (k, ..)."""
    count = int(np.prod(shape))
    values = parameters[:count].astype(complex)
    pairs = np.broadcast_to((weights == 2.0).reshape(-1, *([1] * (len(shape) - 1))), shape).ravel()
    values[pairs] += 1j * parameters[count:]
    return np.asarray(values.reshape(shape), dtype=np.complex128)


def _direct(u: Array, outputs: int) -> Array:
    """Regressors (n, l, l m) of the direct term."""
    return np.asarray(np.einsum("nm,op->nopm", u, np.eye(outputs)).reshape(len(u), outputs, -1))


def _solve(A: Array, b: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
    return np.asarray(np.linalg.lstsq(A / np.outer(scale, scale), b / scale, rcond=1e-13)[0] / scale)


def initial_state(modes: Modes, u: Array, y: Array) -> Complex:
    """State (k,) at the first sample that explains `y` best."""
    columns = _split(modes.free(len(u))[:, None, :] * modes.C[None], modes.weights).reshape(y.size, -1)
    left = (y - modes.simulate(u)).ravel()
    return _join(_solve(columns.T @ columns, columns.T @ left), modes.weights, modes.poles.shape)


def regress(poles: Complex, C: Complex, experiments: Sequence[Experiment], *, direct: bool) -> Modes:
    """Modes with B, and D where `direct`, fitted; every experiment has an initial state of its own."""
    inputs, outputs = experiments[0][0].shape[1], experiments[0][1].shape[1]
    modes = Modes(poles, np.zeros((len(poles), inputs), complex), C, np.zeros((outputs, inputs)))
    common = modes.order * inputs + (outputs * inputs if direct else 0)
    size = common + modes.order * len(experiments)
    A, b = np.zeros((size, size)), np.zeros(size)
    for e, (u, y) in enumerate(experiments):
        driven = _split(modes.responses(u)[:, None] * C[None, :, :, None], modes.weights)
        own = _split(modes.free(len(u))[:, None, :] * C[None], modes.weights)
        parts = [driven, _direct(u, outputs), own] if direct else [driven, own]
        rows = np.concatenate(parts, axis=2).reshape(y.size, -1)
        at = np.concatenate([np.arange(common), common + modes.order * e + np.arange(modes.order)])
        A[np.ix_(at, at)] += rows.T @ rows
        b[at] += rows.T @ y.ravel()
    x = _solve(A, b)
    B = _join(x[: modes.order * inputs], modes.weights, (len(poles), inputs))
    D = x[modes.order * inputs : common].reshape(outputs, inputs) if direct else modes.D
    return replace(modes, B=B, D=D)


def _jacobian(modes: Modes, u: Array, x0: Complex, *, direct: bool) -> tuple[Array, Array]:
    """Output (n, l) and its derivatives (n, l, parameters) by poles, B, C and D."""
    responses, free, weights = modes.responses(u), modes.free(len(u)), modes.weights
    state = np.einsum("nkm,km->nk", responses, modes.B) + free * x0
    # dx+/dp = p dx/dp + x: the state filtered once more
    once_more = modes.through(state)
    by_pole = _split(once_more[:, None, :] * modes.C[None], weights)
    by_b = _split(responses[:, None] * modes.C[None, :, :, None], weights)
    by_c = _split(np.einsum("nk,op->npko", state, np.eye(modes.C.shape[0])), weights)
    y = ((state * weights) @ modes.C.T).real + u @ modes.D.T
    parts = [by_pole, by_b, by_c] + ([_direct(u, y.shape[1])] if direct else [])
    return y, np.concatenate(parts, axis=2)


def _moved(modes: Modes, step: Array, *, direct: bool) -> Modes:
    k, m, outputs = len(modes.poles), modes.B.shape[1], modes.C.shape[0]
    n = modes.order
    poles = modes.poles + _join(step[:n], modes.weights, (k,))
    B = modes.B + _join(step[n : n + n * m], modes.weights, (k, m))
    C = modes.C + _join(step[n + n * m : n + n * m + n * outputs], modes.weights, (k, outputs)).T
    D = modes.D + step[n + n * m + n * outputs :].reshape(outputs, m) if direct else modes.D
    return Modes(poles, B, C, D)


def refine(modes: Modes, experiments: Sequence[Experiment], steps: int, *, direct: bool) -> Modes:
    """`modes` after at most `steps` damped Gauss-Newton steps on the free-run error; never worse than before."""
    starts = [initial_state(modes, u, y) for u, y in experiments]
    damping = _DAMPING
    for _ in range(steps):
        size = modes.order * (1 + modes.B.shape[1] + modes.C.shape[0]) + (modes.D.size if direct else 0)
        A, b, cost = np.zeros((size, size)), np.zeros(size), 0.0
        for (u, y), x0 in zip(experiments, starts, strict=True):
            predicted, rows = _jacobian(modes, u, x0, direct=direct)
            rows, error = rows.reshape(y.size, -1), (y - predicted).ravel()
            A, b, cost = A + rows.T @ rows, b + rows.T @ error, cost + float(error @ error)
        better = None
        while better is None and damping < _DAMPING_LIMIT:
            trial = _moved(modes, _solve(A + damping * np.diag(np.diag(A)), b), direct=direct)
            if np.abs(trial.poles).max() < 1.0:
                states = [initial_state(trial, u, y) for u, y in experiments]
                new = sum(
                    float(np.sum((trial.simulate(u, x) - y) ** 2))
                    for (u, y), x in zip(experiments, states, strict=True)
                )
                if new < cost:
                    better = trial
                    starts = states
            damping = damping / 5.0 if better else damping * 5.0
        if better is None:
            break
        modes = better
        if new > cost * (1.0 - 1e-4):
            break
    return modes
