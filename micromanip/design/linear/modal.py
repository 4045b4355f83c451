"""A linear model as a sum of modes: poles, what drives them and what they show.

``x+ = p x + B u``, ``y = 2 Re(C x) + D u`` over one of each pair of complex poles (a real pole counts once).
Numerically harmless at any order, and a simulation is one recursive filter a mode and input.
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
        """Column k of `x` (n, k) filtered by mode k."""
        columns = [lfilter([0.0, 1.0], [1.0, -pole], column) for pole, column in zip(self.poles, x.T, strict=True)]
        return np.stack(columns, axis=1)

    def free(self, samples: int) -> Complex:
        """Free response of each mode from 1: (n, k)."""
        return np.exp(np.arange(samples)[:, None] * np.log(self.poles[None, :]))

    def simulate(self, u: Array, x0: Complex | None = None) -> Array:
        """Output (n, l) to `u` (n, m) from the state `x0` (k,), at rest if None."""
        x = np.einsum("nkm,km->nk", self.responses(u), self.B)
        if x0 is not None:
            x = x + self.free(len(u)) * x0
        return np.asarray((x * self.weights) @ self.C.T).real + u @ self.D.T

    def state_space(self) -> tuple[Array, Array, Array, Array]:
        """Real ``A, B, C, D``, block-diagonal, each mode's gains in and out alike."""
        blocks, rows, columns = [], [], []
        for pole, b, c, weight in zip(self.poles, self.B, self.C.T, self.weights, strict=True):
            scale = np.sqrt(np.linalg.norm(c) / max(float(np.linalg.norm(b)), 1e-300))
            b, c = b * scale, weight * c / scale
            if weight == 1.0:
                blocks.append(np.array([[pole.real]]))
                rows.append(b.real[None, :])
                columns.append(c.real[:, None])
            else:
                blocks.append(np.array([[pole.real, -pole.imag], [pole.imag, pole.real]]))
                rows.append(np.stack([b.real, b.imag]))
                columns.append(np.stack([c.real, -c.imag], axis=1))
        return np.asarray(block_diag(*blocks)), np.vstack(rows), np.hstack(columns), self.D


def decompose(A: Array, C: Array) -> tuple[Complex, Complex]:
    """Poles (k,) and output vectors (l, k) of ``A, C``, one of each pair; poles outside are reflected, alone."""
    values, vectors = np.linalg.eig(A)
    kept = (values.imag > _REAL) | (np.abs(values.imag) <= _REAL)
    poles = values[kept].astype(complex)
    outside = np.abs(poles) >= 1.0
    poles[outside] = 1.0 / np.conj(poles[outside])
    return poles, (C @ vectors)[:, kept].astype(complex)
