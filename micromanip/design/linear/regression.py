"""Inputs, direct term, initial states and offsets by linear least squares, the poles being known.

Each output is a sum of a few signals (modes' responses, free responses, inputs, 1) whose weights depend on the
parameters: ``y_o = S M_o theta``. So the normal equations of all outputs need one product ``S^T S`` an experiment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .modal import Array, Complex, Modes
from .subspace import Experiment


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
