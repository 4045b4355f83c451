"""A discrete single-input single-output system: matrices, frequency response, series, shift by a delay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Response = Callable[[Array], Complex]
"""Frequency response over angular frequencies (n,), rad/s."""
_FEW = 2
"""Frequencies that are worth a substitution each."""


@dataclass(frozen=True)
class System:
    """``x+ = A x + B u``, ``y = C x + D u`` every `period_s`; A (n, n), B (n,), C (n,)."""

    A: Array
    B: Array
    C: Array
    D: float
    period_s: float

    @cached_property
    def poles(self) -> Complex:
        """Eigenvalues of A."""
        return np.linalg.eigvals(self.A).astype(complex) if len(self.A) else np.zeros(0, complex)

    @cached_property
    def _triangular(self) -> tuple[Complex, Complex, Complex]:
        from scipy.linalg import schur  # not for the host, which asks for no response: its import takes .2 s

        T, Q = schur(self.A.astype(complex), output="complex")
        return np.asfortranarray(T), Q.conj().T @ self.B, self.C @ Q

    @cached_property
    def _identity(self) -> Complex:
        return np.eye(len(self.A), dtype=complex, order="F")

    def response(self, omega: Array) -> Complex:
        """Frequency response (n,), by back substitution in the Schur form: delays and repeated poles do no harm."""
        z = np.exp(1j * np.asarray(omega, dtype=float) * self.period_s)
        if not len(self.A):
            return np.full(len(z), self.D, complex)
        T, b, c = self._triangular
        if len(z) <= _FEW:
            return np.array([self._at(each) for each in z], complex)
        x = np.zeros((len(b), len(z)), complex)
        with np.errstate(divide="ignore", invalid="ignore"):
            for i in range(len(b) - 1, -1, -1):
                x[i] = (b[i] + T[i, i + 1 :] @ x[i + 1 :]) / (z - T[i, i])
            return np.asarray(c @ x + self.D)

    def _at(self, z: complex) -> complex:
        """Response at one point of the plane: LAPACK's substitution is faster where there is one right-hand side."""
        from scipy.linalg.lapack import ztrtrs

        T, b, c = self._triangular
        x, singular = ztrtrs(z * self._identity - T, b)
        return complex(c @ x) + self.D if singular == 0 else complex(np.inf)

    def closed(self) -> Array:
        """State matrix of the loop closed by negative unit feedback."""
        return self.A - np.outer(self.B, self.C) / (1.0 + self.D)

    def then(self, after: System) -> System:
        """Series connection: `after` takes the output of this system."""
        n, m = len(self.A), len(after.A)
        A = np.zeros((n + m, n + m))
        A[:n, :n], A[n:, n:], A[n:, :n] = self.A, after.A, np.outer(after.B, self.C)
        return System(
            A,
            np.concatenate([self.B, after.B * self.D]),
            np.concatenate([after.D * self.C, after.C]),
            self.D * after.D,
            self.period_s,
        )

    def scaled(self, factor: float) -> System:
        """The same with `factor` times the gain."""
        return System(self.A, self.B, factor * self.C, factor * self.D, self.period_s)

    def resampled(self, cycles: int) -> System:
        """The same with an input held for `cycles` periods, seen as often; exact. It must not feed through."""
        if cycles == 1:
            return self
        if self.D != 0.0:
            raise ValueError("a system that feeds through can't be resampled")
        power, held = np.eye(len(self.A)), np.zeros(len(self.A))
        for _ in range(cycles):
            held, power = held + power @ self.B, self.A @ power
        return System(power, held, self.C, 0.0, cycles * self.period_s)


def delay(cycles: float, period_s: float) -> System:
    """Delay of `cycles` >= 0; a part of a cycle by interpolation between its neighbours, exact at low frequencies."""
    if not (np.isfinite(cycles) and cycles >= 0):
        raise ValueError(f"a delay is 0 cycles or more, not {cycles}")
    whole = int(np.floor(cycles))
    part = cycles - whole
    n = whole + (part > 0)
    taps = np.zeros(n + 1)
    taps[whole] = 1.0 - part
    if part > 0:
        taps[whole + 1] = part
    A, B = np.diag(np.ones(max(n - 1, 0)), -1)[:n, :n], np.eye(max(n, 1))[0][:n]
    return System(A, B, taps[1:], float(taps[0]), period_s)
