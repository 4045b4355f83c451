"""A plant within a loop, unstable or not, by its prediction error: the predictor is stable where the plant is not.

``x+ = F x + B u + K y``, ``y = C x + e``: what the past tells of the next sample. A long regression gives its impulse
responses, whatever the feedback; their singular vectors its states (PBSID, Chiuso 2007); Gauss-Newton steps on its
error, the innovations, make it exact. The plant is ``A = F + K C``. An input acts a sample late at least.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import lstsq, qr, svd

from .fit import LARGEST_ORDER, refine
from .modal import Array, Experiment, Modes, decompose
from .model import LinearFit, as_columns, delayed
from .regression import first_answers, regress

_LAGS, _ROWS, _SAMPLES_A_LAG, _RIDGE = 30, 10, 20, 1e-7
_HELD_OUT, _ENOUGH = 4, 1.02
"""One part in so many tells the order: the smallest whose error there is within this factor of the best."""
_STEPS, _SETTLES = 8, 0.05
"""Of Gauss and Newton; share of a part in which the predictor forgets where it began."""


def fit_unstable(
    experiments: Sequence[Experiment],
    dt: float,
    order: int | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> LinearFit:
    """Plant from ``[(u (n, inputs), y (n, outputs)), ..]`` of a closed loop, sampled every `dt` s; poles as they are.

    Its gain is that of the predictor, and `tried` has the error of one step, percent of the outputs' rms, by order.
    Raises ValueError for records that are too short, or stand still.
    """
    pairs = [(as_columns(u), as_columns(y)) for u, y in experiments]
    every_u, every_y = (np.concatenate([pair[side] for pair in pairs]) for side in (0, 1))
    size_u, size_y = every_u.std(axis=0), every_y.std(axis=0)
    if not (np.all(size_u > 0.0) and np.all(size_y > 0.0)):
        raise ValueError("an input or output is constant or not finite")
    mean_u, mean_y = every_u.mean(axis=0), every_y.mean(axis=0)
    scaled = [((u - mean_u) / size_u, (y - mean_y) / size_y) for u, y in pairs]
    channels, shortest = len(size_u) + len(size_y), min(len(u) for u, _ in pairs)
    lags = min(_LAGS, shortest // (_SAMPLES_A_LAG * channels))
    most = min(LARGEST_ORDER, (min(lags, _ROWS) - 1) * len(size_y))
    if most < (order or 1):
        least = 2 * _SAMPLES_A_LAG * channels
        raise ValueError(f"a part of {shortest} samples is too short; at least {least} are needed")
    late = [max(lag - 1, 0) for lag in first_answers(scaled, min(lags, shortest // (4 * channels)))]
    found: dict[tuple[int, int], float] = {}
    for sooner in range(max(late) + 1):
        progress(f"trying delays {', '.join(str(max(each - sooner, 0)) for each in late)}")
        driven = _driven(scaled, late, sooner)
        first = [(z[: -(len(z) // _HELD_OUT)], y[: -(len(y) // _HELD_OUT)]) for z, y in driven]
        states = _states(first, lags)
        for each in range(1, most + 1) if order is None else (order,):
            modes = _found(states, each, first)
            errors = [_error(modes, z, y)[-(len(z) // _HELD_OUT) :] for z, y in driven]
            found[each, sooner] = 100.0 * float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    enough = _ENOUGH * min(found.values())
    order, sooner = min((key for key, error in found.items() if error <= enough), key=lambda key: (key[0], found[key]))
    delays = tuple(max(each - sooner, 0) for each in late)
    driven = _driven(scaled, late, sooner)
    tried = {each: error for (each, shift), error in found.items() if shift == sooner}
    progress(f"refining order {order}")
    modes = refine(_found(_states(driven, lags), order, driven), driven, _STEPS, direct=False)
    F, B, C, D = modes.state_space()
    inputs = len(size_u)
    K = B[:, inputs:]
    values, vectors = np.linalg.eig(F + K @ C)
    kept = values.imag > -1e-12
    back = np.linalg.inv(vectors)[kept]
    plant = Modes(
        values[kept].astype(complex), back @ B[:, :inputs] / size_u, size_y[:, None] * (C @ vectors)[:, kept],
        D[:, :inputs] / size_u * size_y[:, None],
    )  # fmt: skip
    return LinearFit(plant, dt, delays, mean_u, mean_y, np.zeros(0), tried, gain=back @ K / size_y)


def _driven(scaled: Sequence[Experiment], late: Sequence[int], sooner: int) -> list[Experiment]:
    """Delayed inputs with outputs, and outputs."""
    shifted = (delayed(pair, tuple(max(each - sooner, 0) for each in late)) for pair in scaled)
    return [(np.hstack([u, y]), y) for u, y in shifted]


def _states(driven: Sequence[Experiment], lags: int) -> Array:
    """Left singular vectors, by their values, of what the past tells of the next samples: (rows outputs, states)."""
    tables, targets = [], []
    for z, y in driven:
        past = np.hstack([z[lags - lag : len(z) - lag] for lag in range(1, lags + 1)])
        tables.append(past - past.mean(axis=0))
        targets.append(y[lags:] - y[lags:].mean(axis=0))
    past, width, outputs = np.vstack(tables), driven[0][0].shape[1], targets[0].shape[1]
    triangle = qr(past, mode="r")[0][: past.shape[1]]
    ridge = _RIDGE * np.sqrt(len(past)) * np.eye(past.shape[1])
    told = lstsq(np.vstack([past, ridge]), np.vstack([*targets, np.zeros((len(ridge), outputs))]))[0].T
    rows = min(lags, _ROWS)
    whole = np.zeros((rows * outputs, past.shape[1]))
    for row in range(rows):
        whole[row * outputs : (row + 1) * outputs, : (lags - row) * width] = told[:, row * width :]
    left, values, _ = svd(whole @ triangle.T, full_matrices=False)
    return np.asarray(left * np.sqrt(values))


def _found(states: Array, order: int, driven: Sequence[Experiment]) -> Modes:
    outputs = driven[0][1].shape[1]
    gamma = states[:, :order]
    F = np.asarray(lstsq(gamma[:-outputs], gamma[outputs:])[0])
    return regress(*decompose(F, gamma[:outputs]), driven, direct=False)


def _error(modes: Modes, z: Array, y: Array) -> Array:
    """What a predictor leaves of `y` (n, outputs) from `z` (n, inputs and outputs), once it has settled."""
    left = (y - modes.simulate(z))[round(_SETTLES * len(y)) :]
    return np.asarray(left - left.mean(axis=0))


def horizon(model: LinearFit, samples: int) -> int:
    """Samples in which what is unstable grows e-fold, at most a tenth of all: so far ahead a model is judged."""
    fastest = float(np.abs(model.poles).max())
    growing = 1.0 / np.log(fastest) if fastest > 1.0 else np.inf
    return max(1, round(min(growing, samples / 10)))


def foretold_errors(model: LinearFit, experiments: Sequence[Experiment], ahead: int) -> Array:
    """Rms error (outputs,) of the output as it is foretold `ahead` samples, inputs known, percent of its rms.

    ValueError where no part is long enough, or the model has no predictor's gain.
    """
    if model.gain is None:
        raise ValueError("the model has no predictor's gain")
    plant, inputs = model.modes, model.modes.B.shape[1]
    D = plant.D
    both = Modes(plant.poles, np.hstack([plant.B, model.gain]), plant.C, np.hstack([D, np.zeros((len(D), len(D)))]))
    A, driving, C, _ = both.state_space()
    B, K = driving[:, :inputs], driving[:, inputs:]
    squares = []
    for u, y in experiments:
        driven, seen = delayed((as_columns(u) - model.offsets_u, as_columns(y) - model.offsets_y), model.delays)
        if len(seen) < 4 * ahead:
            continue
        x = np.zeros((len(seen), len(A)))
        for k in range(len(seen) - 1):
            x[k + 1] = A @ x[k] + B @ driven[k] + K @ (seen[k] - C @ x[k] - D @ driven[k])
        count = len(seen) - ahead + 1
        x = x[:count]
        for step in range(ahead - 1):
            x = x @ A.T + driven[step : step + count] @ B.T
        left = (seen[ahead - 1 :] - x @ C.T - driven[ahead - 1 :] @ D.T)[round(_SETTLES * count) :]
        squares.append((left - left.mean(axis=0)) ** 2 / seen.var(axis=0))
    if not squares:
        raise ValueError(f"no part is long enough to foretell {ahead} samples of it")
    return np.asarray(100.0 * np.sqrt(np.mean(np.concatenate(squares), axis=0)))
