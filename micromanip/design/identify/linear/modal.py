"""A linear model as a sum of modes: poles, what drives them and what they show.

``x+ = p x + B u``, ``y = 2 Re(C x) + D u`` over one of each pair of complex poles (a real pole counts once).
Numerically harmless at any order, and a simulation is one recursive filter a mode.

Past-output MOESP (Verhaegen 1994) for several inputs, outputs and experiments.

Future outputs, freed of what future inputs explain, are projected on past inputs and outputs; the column space
is the extended observability matrix. The block Hankel matrices of all experiments go through one QR factorisation
block by block, so that memory does not grow with the record. An offset of each experiment is an input that is 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, lstsq, qr, svd
from scipy.signal import lfilter

from micromanip.control.system import Array, Complex

Experiment = tuple[Array, Array]

_BLOCK_COLUMNS = 4096


def block_hankel(signal: Array, rows: int, first: int, last: int) -> Array:
    """Columns `first` .. `last` of the block Hankel matrix of a signal (n, channels), `rows` block rows."""
    window = np.lib.stride_tricks.sliding_window_view(signal[first : last + rows - 1], rows, axis=0)
    return np.asarray(window.transpose(2, 1, 0).reshape(rows * signal.shape[1], -1))


def observability(experiments: Sequence[Experiment], block_rows: int) -> tuple[Array, Array]:
    """Left singular vectors (block_rows outputs, ..) of the projection, and its singular values.

    Of the data ``(u (n, inputs), y (n, outputs))`` of all experiments.
    """
    i = block_rows
    inputs, outputs = experiments[0][0].shape[1], experiments[0][1].shape[1]
    size = len(experiments) + 2 * i * (inputs + outputs)
    triangle = np.zeros((0, size))
    for e, (u, y) in enumerate(experiments):
        columns = len(u) - 2 * i + 1
        for first in range(0, columns, _BLOCK_COLUMNS):
            last = min(columns, first + _BLOCK_COLUMNS)
            offsets = np.zeros((len(experiments), last - first))
            offsets[e] = 1.0
            hu, hy = block_hankel(u, 2 * i, first, last), block_hankel(y, 2 * i, first, last)
            parts = [offsets, hu[i * inputs :], hu[: i * inputs], hy[: i * outputs], hy[i * outputs :]]
            stacked = np.vstack([triangle, np.vstack(parts).T])
            triangle = np.asarray(qr(stacked, mode="r", check_finite=False)[0][:size])
    past = len(experiments) + i * inputs
    future = past + i * (inputs + outputs)
    left, values, _ = svd(triangle.T[future:, past:future], full_matrices=False)
    return np.asarray(left), np.asarray(values)


def dynamics(left: Array, order: int, outputs: int) -> tuple[Array, Array]:
    """``A`` (n, n) and ``C`` (outputs, n) from the first `order` columns, by shift invariance."""
    gamma = left[:, :order]
    return np.asarray(lstsq(gamma[:-outputs], gamma[outputs:])[0]), gamma[:outputs].copy()


_REAL = 1e-12
_STABLE = 1.0 - 1e-9


@dataclass(frozen=True)
class Modes:
    """Poles (k,), inputs ``B`` (k, m), outputs ``C`` (l, k), direct term ``D`` (l, m)."""

    poles: Complex
    B: Complex
    C: Complex
    D: Array

    @property
    def weights(self) -> Array:
        """How often each mode counts: 2 for one of a complex pair, 1 for a real pole."""
        return np.where(np.abs(self.poles.imag) < _REAL, 1.0, 2.0)

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.weights.sum())

    def responses(self, u: Array) -> Complex:
        """Each mode's response to each input alone: (n, k, m)."""
        filtered = [lfilter([0.0, 1.0], [1.0, -pole], u.astype(complex), axis=0) for pole in self.poles]
        return np.stack(filtered, axis=1)

    def through(self, x: Complex) -> Complex:
        """Column k of `x` (n, k) filtered by mode k: its response to what drives it."""
        columns = [lfilter([0.0, 1.0], [1.0, -pole], column) for pole, column in zip(self.poles, x.T, strict=True)]
        return np.stack(columns, axis=1)

    def free(self, samples: int) -> Complex:
        """Free response of each mode from 1: (n, k)."""
        impulse = np.zeros(samples, complex)
        impulse[0] = 1.0
        return np.stack([lfilter([1.0], [1.0, -pole], impulse) for pole in self.poles], axis=1)

    def simulate(self, u: Array, x0: Complex | None = None) -> Array:
        """Output (n, l) to `u` (n, m) from the state `x0` (k,), at rest if None."""
        x = self.through(u @ self.B.T)
        if x0 is not None:
            x = x + self.free(len(u)) * x0
        return np.asarray((x * self.weights) @ self.C.T).real + u @ self.D.T

    def frequency_response(self, z: Complex) -> Complex:
        """Transfer matrix (f, l, m) at the points `z` (f,) of the complex plane."""
        real = self.weights == 1.0
        whole = 1.0 / (z[:, None] - self.poles)
        twin = np.where(real, 0.0, 1.0) / (z[:, None] - np.conj(self.poles))
        response = np.einsum("lk,fk,km->flm", self.C, whole, self.B)
        response += np.einsum("lk,fk,km->flm", np.conj(self.C), twin, np.conj(self.B))
        return np.asarray(response + self.D)

    def state_space(self) -> tuple[Array, Array, Array, Array]:
        """Real ``A, B, C, D``, block-diagonal, each mode's gains in and out alike."""
        size_in = np.maximum(np.linalg.norm(self.B, axis=1), 1e-300)
        scales = np.sqrt(np.maximum(np.linalg.norm(self.C, axis=0), 1e-300) / size_in)
        parts = zip(self.poles, self.B * scales[:, None], (self.C * self.weights / scales).T, self.weights, strict=True)
        blocks, rows, columns = [], [], []
        for pole, b, c, weight in parts:
            states = int(weight)
            blocks.append(np.array([[pole.real, -pole.imag], [pole.imag, pole.real]])[:states, :states])
            rows.append(np.stack([b.real, b.imag])[:states])
            columns.append(np.stack([c.real, -c.imag], axis=1)[:, :states])
        return np.asarray(block_diag(*blocks)), np.vstack(rows), np.hstack(columns), self.D


def decompose(A: Array, C: Array) -> tuple[Complex, Complex]:
    """Poles (k,) and output vectors (l, k) of ``A, C``, one of each pair; poles outside are reflected, alone."""
    values, vectors = np.linalg.eig(A)
    kept = values.imag > -_REAL
    poles = values[kept].astype(complex)
    outside = np.abs(poles) >= 1.0
    poles[outside] = 1.0 / np.conj(poles[outside])
    poles *= np.minimum(1.0, _STABLE / np.maximum(np.abs(poles), 1e-300))
    return poles, (C @ vectors)[:, kept].astype(complex)
