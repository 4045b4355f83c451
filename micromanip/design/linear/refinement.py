"""Output-error refinement: a few damped Gauss-Newton steps on the free run polish poles, B, C, D and the starts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .modal import Array, Modes
from .regression import NormalEquations, Start, block, join, mixing, real_columns, solve, start
from .subspace import Experiment

_DAMPING, _DAMPING_LIMIT = 1e-3, 1e6
_GAIN = 1e-4
"""A step that takes less than this share off the cost is the last."""


def _signals(modes: Modes, u: Array, begin: Start) -> tuple[Array, Array]:
    """Free run (n, l) and the signals that its derivatives are made of."""
    responses, free = modes.responses(u), modes.free(len(u))
    state = np.einsum("nkm,km->nk", responses, modes.B) + free * begin.x0
    # dx+/dp = p dx/dp + x: the state filtered once more
    parts = [modes.through(state), responses.reshape(len(u), -1), state, free]
    y = ((state * modes.weights) @ modes.C.T).real + u @ modes.D.T + begin.offset
    return y, np.hstack([*(real_columns(part) for part in parts), u, np.ones((len(u), 1))])


def _mixes(modes: Modes, *, direct: bool) -> tuple[list[Array], int]:
    """For each output the weights of `_signals` in its derivatives; parameters in the order of `_moved`."""
    k, m, outputs, n, w = len(modes.poles), modes.B.shape[1], len(modes.C), modes.order, modes.weights
    at_b, at_c, at_d = n, n + n * m, n + n * m + n * outputs
    common = at_d + (outputs * m if direct else 0)
    rows = 2 * k * (m + 3) + m + 1
    mixes = []
    for o in range(outputs):
        coefficients = modes.C[o]
        parts = [
            (0, 0, mixing(coefficients, w, 1)),
            (2 * k, at_b, mixing(coefficients, w, m)),
            (2 * k * (m + 1), at_c + n * o, mixing(np.ones(k, complex), w, 1)),
            (2 * k * (m + 2), common, mixing(coefficients, w, 1)),
            (rows - 1, common + n + o, np.ones((1, 1))),
        ]
        if direct:
            parts.append((2 * k * (m + 3), at_d + m * o, np.eye(m)))
        mixes.append(block(rows, *parts, columns=common + n + outputs))
    return mixes, common


def _moved(modes: Modes, step: Array, *, direct: bool) -> Modes:
    k, m, outputs, n, w = len(modes.poles), modes.B.shape[1], len(modes.C), modes.order, modes.weights
    at_c, at_d = n + n * m, n + n * m + n * outputs
    poles = modes.poles + join(step[:n], w, (k,))
    B = modes.B + join(step[n:at_c], w, (k, m))
    C = modes.C + np.stack([join(step[at_c + n * o : at_c + n * (o + 1)], w, (k,)) for o in range(outputs)])
    D = modes.D + step[at_d : at_d + outputs * m].reshape(outputs, m) if direct else modes.D
    return Modes(poles, B, C, D)


def _error(modes: Modes, experiments: Sequence[Experiment]) -> tuple[float, list[Start]]:
    starts = [start(modes, u, y) for u, y in experiments]
    runs = (begin.run(modes, u) - y for (u, y), begin in zip(experiments, starts, strict=True))
    return sum(float(np.sum(error**2)) for error in runs), starts


def refine(modes: Modes, experiments: Sequence[Experiment], steps: int, *, direct: bool) -> Modes:
    """`modes` after at most `steps` damped Gauss-Newton steps on the free-run error; never worse than before."""
    cost, starts = _error(modes, experiments)
    damping = _DAMPING
    for _ in range(steps):
        mixes, common = _mixes(modes, direct=direct)
        equations = NormalEquations(common, modes.order + len(modes.C), len(experiments))
        for e, ((u, y), begin) in enumerate(zip(experiments, starts, strict=True)):
            predicted, signals = _signals(modes, u, begin)
            equations.add(e, signals, mixes, y - predicted)
        before = cost
        while damping < _DAMPING_LIMIT:
            step = solve(equations.A + damping * np.diag(np.diag(equations.A)), equations.b)
            trial = _moved(modes, step, direct=direct)
            if np.abs(trial.poles).max() < 1.0:
                new, states = _error(trial, experiments)
                if new < cost:
                    modes, cost, starts = trial, new, states
                    damping /= 5.0
                    break
            damping *= 5.0
        if cost > before * (1.0 - _GAIN):
            break
    return modes
