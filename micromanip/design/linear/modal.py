"""A linear model as a sum of modes: poles, what drives them and what they show.

``x+ = p x + B u``, ``y = 2 Re(C x) + D u`` over one of each pair of complex poles (a real pole counts once).
Numerically harmless at any order, and a simulation is one recursive filter a mode.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.signal import lfilter

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

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

    def real_rows(self, values: Complex) -> Array:
        """What drives the modes, (k, q), as rows of the real, block-diagonal form, (order, q)."""
        scaled = values * self._scales[:, None]
        pairs = zip(scaled, self.weights, strict=True)
        return np.vstack([np.stack([row.real, row.imag])[: int(weight)] for row, weight in pairs])

    def complex_rows(self, rows: Array) -> Complex:
        """Inverse of `real_rows`."""
        first = np.concatenate([[0.0], np.cumsum(self.weights)[:-1]]).astype(int)
        imaginary = np.where(self.weights[:, None] == 2.0, rows[np.minimum(first + 1, len(rows) - 1)], 0.0)
        return np.asarray((rows[first] + 1j * imaginary) / self._scales[:, None])

    def state_space(self) -> tuple[Array, Array, Array, Array]:
        """Real ``A, B, C, D``, block-diagonal, each mode's gains in and out alike."""
        blocks, columns = [], []
        for pole, c, weight in zip(self.poles, (self.C * self.weights / self._scales).T, self.weights, strict=True):
            if weight == 1.0:
                blocks.append(np.array([[pole.real]]))
                columns.append(c.real[:, None])
            else:
                blocks.append(np.array([[pole.real, -pole.imag], [pole.imag, pole.real]]))
                columns.append(np.stack([c.real, -c.imag], axis=1))
        return np.asarray(block_diag(*blocks)), self.real_rows(self.B), np.hstack(columns), self.D

    @property
    def _scales(self) -> Array:
        size_in = np.maximum(np.linalg.norm(self.B, axis=1), 1e-300)
        return np.asarray(np.sqrt(np.maximum(np.linalg.norm(self.C, axis=0), 1e-300) / size_in))


def decompose(A: Array, C: Array) -> tuple[Complex, Complex]:
    """Poles (k,) and output vectors (l, k) of ``A, C``, one of each pair; poles outside are reflected, alone."""
    values, vectors = np.linalg.eig(A)
    kept = values.imag > -_REAL
    poles = values[kept].astype(complex)
    outside = np.abs(poles) >= 1.0
    poles[outside] = 1.0 / np.conj(poles[outside])
    poles *= np.minimum(1.0, _STABLE / np.maximum(np.abs(poles), 1e-300))
    return poles, (C @ vectors)[:, kept].astype(complex)
