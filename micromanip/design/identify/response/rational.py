"""A rational model of a measured frequency response: vector fitting, then least squares by Gauss and Newton.

``G(z) = z^-d sum r_i / (z - p_i)``. Vector fitting moves the poles, in a basis of partial fractions that stays well
conditioned at any order (Gustavsen and Semlyen 1999, relaxed: Gustavsen 2006); the steps after it take away the
bias that noise leaves there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import Array, Complex
from micromanip.design.identify.linear import Modes

_RELOCATIONS, _STEPS = 12, 15
_FARTHEST = 1.0 - 1e-6
_UNSEEN = 0.6
_REAL = 1e-12
_SLOWEST_DAMPING = 0.02


def fit_rational(frequency_Hz: Array, response: Complex, deviation: Array, order: int, delay: int, dt: float) -> Modes:
    """Modes of `order` states behind `delay` samples that fit `response` (k,), each line by its `deviation` (k,)."""
    z = np.exp(2j * np.pi * frequency_Hz * dt)
    target, weight = response * z**delay, 1.0 / deviation
    poles = _starting(frequency_Hz, order, dt)
    for _ in range(_RELOCATIONS):
        poles = _tamed(_relocated(poles, z, target, weight), z)
    poles, residues = _polished(poles, _residues(poles, z, target, weight), z, target, weight)
    tamed = _tamed(poles, z)
    if np.any(tamed != poles):
        poles, residues = tamed, _residues(tamed, z, target, weight)
    return Modes(poles, np.ones((len(poles), 1), complex), residues[None, :], np.zeros((1, 1)))


def _starting(frequency_Hz: Array, order: int, dt: float) -> Complex:
    """Lightly damped pairs, evenly over the logarithm of the frequency, and a real pole for an odd order."""
    pairs = np.geomspace(frequency_Hz[0] * 3.0, frequency_Hz[-1], max(order // 2, 1))[: order // 2]
    swinging = np.exp(2 * np.pi * pairs * dt * (-_SLOWEST_DAMPING + 1j))
    real = [np.exp(-2 * np.pi * 0.3 * frequency_Hz[-1] * dt)] if order % 2 else []
    return np.concatenate([swinging, np.array(real, complex)])


def _is_real(poles: Complex) -> NDArray[np.bool_]:
    return np.abs(poles.imag) < _REAL


def _basis(poles: Complex, z: Complex) -> Complex:
    """Partial fractions (k, order) with real coefficients: one of a real pole, two of a pair."""
    columns = []
    for pole, real in zip(poles, _is_real(poles), strict=True):
        one = 1.0 / (z - pole)
        if real:
            columns.append(one)
        else:
            twin = 1.0 / (z - np.conj(pole))
            columns += [one + twin, 1j * (one - twin)]
    return np.array(columns).T


def _stacked(rows: Complex, weight: Array) -> Array:
    weighted = rows * (weight[:, None] if rows.ndim == 2 else weight)
    return np.concatenate([weighted.real, weighted.imag])


def _solved(matrix: Array, target: Array) -> Array:
    scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    solution: Array = np.linalg.lstsq(matrix / scale, target, rcond=None)[0] / scale
    return solution


def _relocated(poles: Complex, z: Complex, target: Complex, weight: Array) -> Complex:
    """Poles moved to the zeros of the fitted weighting function, reflected where they are unstable."""
    basis = _basis(poles, z)
    count, n = len(z), basis.shape[1]
    scaled = weight * np.abs(target)
    whole = np.hstack([basis, -target[:, None] * basis, -target[:, None]])
    matrix = _stacked(whole, weight)
    # relaxed: the weighting function's mean is 1, not its value far away
    share = float(np.linalg.norm(scaled)) / count
    mean = share * np.concatenate([np.zeros(n), basis.real.sum(axis=0), [count]])
    solution = _solved(np.vstack([matrix, mean]), np.append(np.zeros(2 * count), share * count))
    far = solution[-1] if abs(solution[-1]) > 1e-8 else 1e-8
    A, b = np.zeros((n, n)), np.zeros(n)
    at = 0
    for pole, real in zip(poles, _is_real(poles), strict=True):
        if real:
            A[at, at], b[at], at = pole.real, 1.0, at + 1
        else:
            A[at : at + 2, at : at + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
            b[at], at = 2.0, at + 2
    found = np.linalg.eigvals(A - np.outer(b, solution[n : 2 * n]) / far).astype(complex)
    return _stable(found)


def _stable(found: Complex) -> Complex:
    """One of each pair, inside the unit circle."""
    kept = found[found.imag > -_REAL]
    kept = np.where(_is_real(kept), kept.real + 0j, kept)
    outside = np.abs(kept) >= 1.0
    kept[outside] = 1.0 / np.conj(kept[outside])
    size = np.abs(kept)
    return np.asarray(np.where(size > _FARTHEST, kept * (_FARTHEST / np.maximum(size, 1e-300)), kept))


def _tamed(poles: Complex, z: Complex) -> Complex:
    """No resonance above the highest line: nothing was seen there, and a loop would be built on it."""
    above = np.abs(np.angle(poles)) > np.abs(np.angle(z)).max()
    size = np.maximum(np.abs(poles), 1e-300)
    return np.asarray(np.where(above & (size > _UNSEEN), poles * (_UNSEEN / size), poles))


def _residues(poles: Complex, z: Complex, target: Complex, weight: Array) -> Complex:
    solution = _solved(_stacked(_basis(poles, z), weight), _stacked(target, weight))
    residues, at = [], 0
    for real in _is_real(poles):
        residues.append(solution[at] + 0j if real else solution[at] + 1j * solution[at + 1])
        at += 1 if real else 2
    return np.array(residues)


def _value(poles: Complex, residues: Complex, z: Complex) -> Complex:
    one = residues / (z[:, None] - poles)
    twin = np.where(_is_real(poles), 0.0, np.conj(residues)) / (z[:, None] - np.conj(poles))
    return np.asarray((one + twin).sum(axis=1))


def _polished(poles: Complex, residues: Complex, z: Complex, target: Complex, weight: Array) -> tuple[Complex, Complex]:
    """Damped Gauss-Newton steps on the poles, the residues solved for at each; never worse than before."""

    def cost_of(p: Complex) -> tuple[float, Complex, Array]:
        r = _residues(p, z, target, weight)
        error = _stacked(target - _value(p, r, z), weight)
        return float(error @ error), r, error

    cost, residues, error = cost_of(poles)
    damping = 1e-3
    for _ in range(_STEPS):
        real = _is_real(poles)
        columns = [_basis(poles, z)]
        for pole, residue, is_real in zip(poles, residues, real, strict=True):
            one = residue / (z - pole) ** 2
            if is_real:
                columns.append(one[:, None])
            else:
                twin = np.conj(residue) / (z - np.conj(pole)) ** 2
                columns.append(np.array([one + twin, 1j * (one - twin)]).T)
        jacobian = _stacked(np.hstack(columns), weight)
        scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        normal, slope = (jacobian / scale).T @ (jacobian / scale), (jacobian / scale).T @ error
        before, n = cost, columns[0].shape[1]
        while damping < 1e6:
            step = np.linalg.solve(normal + damping * np.eye(len(normal)), slope) / scale
            moved, at = poles.copy(), n
            for i, is_real in enumerate(real):
                moved[i] += step[at] if is_real else step[at] + 1j * step[at + 1]
                at += 1 if is_real else 2
            if np.abs(moved).max() < 1.0 and np.all(real | (moved.imag > _REAL)):
                trial, r, e = cost_of(moved)
                if trial < cost:
                    poles, residues, cost, error, damping = moved, r, trial, e, damping / 5.0
                    break
            damping *= 5.0
        if cost > before * (1.0 - 1e-4):
            break
    return poles, residues
