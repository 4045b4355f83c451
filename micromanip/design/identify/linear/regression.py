"""Inputs, direct term, initial states and offsets by linear least squares, the poles being known.

Each output is a sum of a few signals (modes' responses, free responses, inputs, 1) whose weights depend on the
parameters: ``y_o = S M_o theta``. So the normal equations of all outputs need one product ``S^T S`` an experiment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from micromanip.control.system import Array, Complex

from .modal import Experiment, Modes, block_hankel

# ``y[k] = sum a_i y[k-i] + sum b_i u[k-i] + e[k]``: whatever the dynamics and however long they ring, the first `b_i`
# that differs from zero sits at the input's delay. "Differs" is judged by its standard error.

_SIGNIFICANT = 6.0
"""Standard errors; some hundred coefficients are looked at."""
_VISIBLE = 0.01
"""Share of the input's largest coefficient: what is smaller is the rounding of a record without noise."""
_TRACE = 1e-12
"""Ridge, relative: without noise the past outputs are linearly dependent."""
_PAST, _COLUMNS = 20, 2048
"""Past outputs that are regressed on, at most: more than any order takes; samples that are looked at at once."""


def first_answers(experiments: Sequence[Experiment], lags: int) -> list[int | None]:
    """The lag (samples, 0 .. `lags`) at which each input first shows in any output; None where it does not.

    Signals of the experiments ``(u (n, inputs), y (n, outputs))`` should be of like size.
    """
    inputs, outputs = experiments[0][0].shape[1], experiments[0][1].shape[1]
    past = min(lags, _PAST)
    by_u = slice(1, 1 + inputs * (lags + 1))
    size = by_u.stop + outputs * past
    gram, rows = np.zeros((size + outputs, size + outputs)), 0
    for u, y in experiments:
        for first in range(0, len(u) - lags, _COLUMNS):
            last = min(first + _COLUMNS, len(u) - lags)
            before, now = block_hankel(u, lags + 1, first, last), block_hankel(y[lags - past :], past + 1, first, last)
            table = np.vstack([np.ones((1, last - first)), before, now])
            gram += table @ table.T
            rows += last - first
    R = np.asarray(cholesky(gram[:size, :size] + _TRACE * rows * np.eye(size)))
    inverse = np.asarray(solve_triangular(R, np.eye(size)))
    seen = inverse.T @ gram[:size, size:]
    left = np.sqrt(np.maximum(np.diag(gram)[size:] - np.sum(seen**2, axis=0), 0.0) / max(rows - size, 1))
    # the block Hankel matrix has the oldest sample first
    b = (inverse @ seen)[by_u].reshape(lags + 1, inputs, outputs)[::-1]
    spread = np.sqrt(np.sum(inverse**2, axis=1)[by_u].reshape(lags + 1, inputs))[::-1, :, None] * left
    shows = (np.abs(b) > _SIGNIFICANT * spread) & (np.abs(b) > _VISIBLE * np.abs(b).max(axis=0))
    return [int(np.argmax(one)) if one.any() else None for one in shows.any(axis=2).T]


@dataclass(frozen=True)
class Start:
    """Where an experiment begins: state (k,) of the modes at its first sample, and offset (l,) of its outputs."""

    x0: Complex
    offset: Array

    def run(self, modes: Modes, u: Array) -> Array:
        """Free run (n, l) from here."""
        return modes.simulate(u, self.x0) + self.offset


def real_columns(values: Complex) -> Array:
    """Complex columns (n, c) as twice as many real ones: all real parts, then all imaginary parts."""
    return np.concatenate([values.real, values.imag], axis=1)


def paired(weights: Array, repeats: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which of the complex parameters (k, repeats), flat, have an imaginary part."""
    return np.repeat(weights == 2.0, repeats)


def mixing(coefficients: Complex, weights: Array, repeats: int) -> Array:
    """Weights of the real columns of signals (k, repeats) in ``sum w Re(c z theta)``, by the real parameters theta."""
    c = np.repeat(coefficients * weights, repeats)
    real = np.vstack([np.diag(c.real), np.diag(-c.imag)])
    imaginary = np.vstack([np.diag(-c.imag), np.diag(-c.real)])
    return np.hstack([real, imaginary[:, paired(weights, repeats)]])


def join(parameters: Array, weights: Array, shape: tuple[int, ...]) -> Complex:
    """Real parameters, in the order of `mixing`, as complex values of `shape` (k, ..)."""
    count = int(np.prod(shape))
    values = parameters[:count].astype(complex)
    values[paired(weights, count // shape[0])] += 1j * parameters[count:]
    return np.asarray(values.reshape(shape), dtype=np.complex128)


def solve(A: Array, b: Array) -> Array:
    """Solution of normal equations of any scale."""
    scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
    return np.asarray(np.linalg.lstsq(A / np.outer(scale, scale), b / scale, rcond=1e-13)[0] / scale)


class NormalEquations:
    """Sums over experiments: parameters that all share come first, then those of each experiment."""

    def __init__(self, common: int, own: int, experiments: int) -> None:
        self.common, self.own = common, own
        size = common + own * experiments
        self.A, self.b = np.zeros((size, size)), np.zeros(size)

    def add(self, experiment: int, signals: Array, mixes: Sequence[Array], target: Array) -> None:
        """Experiment number `experiment`: ``target[:, o] = signals @ mixes[o] @ parameters``."""
        gram, cross = signals.T @ signals, signals.T @ target
        at = np.concatenate([np.arange(self.common), self.common + experiment * self.own + np.arange(self.own)])
        for o, mix in enumerate(mixes):
            self.A[np.ix_(at, at)] += mix.T @ gram @ mix
            self.b[at] += mix.T @ cross[:, o]


def block(rows: int, *parts: tuple[int, int, Array], columns: int) -> Array:
    """A (rows, columns) matrix with each part (row, column, values) in its place."""
    whole = np.zeros((rows, columns))
    for row, column, values in parts:
        whole[row : row + values.shape[0], column : column + values.shape[1]] += values
    return whole


def start(modes: Modes, u: Array, y: Array) -> Start:
    """State at the first sample and offset of the outputs that explain `y` (n, l) best."""
    k, outputs, own = len(modes.poles), len(modes.C), modes.order
    signals = np.hstack([real_columns(modes.free(len(u))), np.ones((len(u), 1))])
    equations = NormalEquations(0, own + outputs, 1)
    equations.add(0, signals, [_own(modes, o) for o in range(outputs)], y - modes.simulate(u))
    found = solve(equations.A, equations.b)
    return Start(join(found[:own], modes.weights, (k,)), found[own:])


def _own(modes: Modes, o: int) -> Array:
    """How initial state and offsets show in output `o`, by free responses and 1."""
    k, outputs = len(modes.poles), len(modes.C)
    parts = (0, 0, mixing(modes.C[o], modes.weights, 1)), (2 * k, modes.order + o, np.ones((1, 1)))
    return block(2 * k + 1, *parts, columns=modes.order + outputs)


def regress(poles: Complex, C: Complex, experiments: Sequence[Experiment], *, direct: bool) -> Modes:
    """Modes with B, and D where `direct`, fitted; each experiment has an initial state and offsets of its own."""
    inputs, outputs, k = experiments[0][0].shape[1], experiments[0][1].shape[1], len(poles)
    modes = Modes(poles, np.zeros((k, inputs), complex), C, np.zeros((outputs, inputs)))
    driven, n = modes.order * inputs, modes.order
    common = driven + (outputs * inputs if direct else 0)
    rows = 2 * k * inputs + (inputs if direct else 0)
    equations = NormalEquations(common, n + outputs, len(experiments))
    mixes = []
    for o in range(outputs):
        parts = [(0, 0, mixing(C[o], modes.weights, inputs)), (rows, common, _own(modes, o))]
        if direct:
            parts.append((2 * k * inputs, driven + o * inputs, np.eye(inputs)))
        mixes.append(block(rows + 2 * k + 1, *parts, columns=common + n + outputs))
    for e, (u, y) in enumerate(experiments):
        responses = real_columns(modes.responses(u).reshape(len(u), -1))
        through = [u] if direct else []
        free = real_columns(modes.free(len(u)))
        equations.add(e, np.hstack([responses, *through, free, np.ones((len(u), 1))]), mixes, y)
    x = solve(equations.A, equations.b)
    B = join(x[:driven], modes.weights, (k, inputs))
    D = x[driven:common].reshape(outputs, inputs) if direct else modes.D
    return replace(modes, B=B, D=D)
