"""Limit cycles predicted by the describing function: where -1/N(A) meets the Nyquist curve of the linear rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class LimitCycle:
    """Oscillation that would keep itself up: amplitude at the nonlinear element, frequency, residual of L N = -1."""

    amplitude: float
    frequency_Hz: float
    residual: float


def limit_cycles(
    gain: Callable[[float], complex], amplitudes: Array, response: Callable[[Array], Complex], omega: Array
) -> list[LimitCycle]:
    """All intersections of ``-1/N(A)`` with ``L(i omega)``, both followed along their grids, then refined.

    `gain` gives N at one amplitude, `amplitudes` (k,) is the grid; `response` gives L at `omega` (n,), rad/s.
    An amplitude where N is not finite interrupts the locus.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        locus = np.asarray(-1.0 / np.array([gain(float(a)) for a in amplitudes]), dtype=complex)
    curve = response(omega)
    found: list[LimitCycle] = []
    for i, j in _crossings(locus, curve):
        start = np.log([0.5 * (amplitudes[i] + amplitudes[i + 1]), 0.5 * (omega[j] + omega[j + 1])])
        bounds = np.log([[amplitudes[i], omega[j]], [amplitudes[i + 1], omega[j + 1]]])
        solved = root(_mismatch, start, args=(gain, response))
        # the solver may run off; then the crossing of the two pieces themselves is the answer
        inside = ((solved.x >= bounds[0] - 0.1) & (solved.x <= bounds[1] + 0.1)).all()
        x = solved.x if solved.success and inside else start
        cycle = LimitCycle(
            float(np.exp(x[0])),
            float(np.exp(x[1]) / (2 * np.pi)),
            float(np.hypot(*_mismatch(x, gain, response))),
        )
        if not any(np.allclose([c.amplitude, c.frequency_Hz], [cycle.amplitude, cycle.frequency_Hz]) for c in found):
            found.append(cycle)
    return found


def _mismatch(x: Array, gain: Callable[[float], complex], response: Callable[[Array], Complex]) -> Array:
    amplitude, omega = np.exp(x)
    product = complex(response(np.array([omega]))[0]) * gain(float(amplitude)) + 1.0
    return np.array([product.real, product.imag])


def _crossings(p: Complex, q: Complex) -> list[tuple[int, int]]:
    """Pairs of segments of the polylines `p` and `q` that cross."""
    a, b = p[:-1, None], p[1:, None]
    c, d = q[None, :-1], q[None, 1:]

    def side(origin: Complex, end: Complex, point: Complex) -> Array:
        return np.asarray(np.sign((np.conj(end - origin) * (point - origin)).imag))

    with np.errstate(invalid="ignore"):
        apart = side(a, b, c) * side(a, b, d)
        across = side(c, d, a) * side(c, d, b)
        hit = (apart < 0) & (across <= 0)
    return [(int(i), int(j)) for i, j in np.argwhere(hit)]
