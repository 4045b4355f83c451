"""Linear dynamics from a recording by subspace identification (PO-MOESP), then least squares.

Past-output MOESP (Verhaegen 1994): the extended observability matrix from a QR factorisation of block
Hankel matrices with past inputs and outputs as instruments; A and C from its shift invariance; B and
x0 by linear least squares on the simulated output. Works on differences from the mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq, qr, svd
from scipy.signal import dlsim

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SubspaceModel:
    """``x+ = A x + B u``, ``y = C x`` (no direct term), its singular values and free-run fit (percent)."""

    A: Array
    B: Array
    C: Array
    singular_values: Array
    fit_percent: float


def _hankel(signal: Array, rows: int, columns: int) -> Array:
    return np.lib.stride_tricks.sliding_window_view(signal, columns)[:rows]


def observability(u: Array, y: Array, block_rows: int) -> tuple[Array, Array]:
    """Left singular vectors and singular values of the projected future outputs of a SISO record."""
    columns = len(u) - 2 * block_rows + 1
    past_future_u = _hankel(u, 2 * block_rows, columns)
    past_future_y = _hankel(y, 2 * block_rows, columns)
    stacked = np.vstack(
        [past_future_u[block_rows:], past_future_u[:block_rows], past_future_y[:block_rows], past_future_y[block_rows:]]
    )
    triangle = qr(stacked.T, mode="r")[0][: len(stacked)].T
    i = block_rows
    left, values, _ = svd(triangle[3 * i :, i : 3 * i])
    return left, values


def simulate(A: Array, B: Array, C: Array, u: Array) -> Array:
    """Free-run response (n,) to `u` (n,), from rest."""
    return np.asarray(dlsim((A, B[:, None], C[None, :], np.zeros((1, 1)), 1.0), u)[1][:, 0])


def modal(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    """Real modal (block-diagonal) form, each mode scaled so that its gains in and out are alike."""
    values, vectors = np.linalg.eig(A)
    order = np.argsort(-np.abs(values))
    columns, k = [], 0
    values, vectors = values[order], vectors[:, order]
    while k < len(values):
        if abs(values[k].imag) < 1e-12:
            columns.append(vectors[:, k].real)
            k += 1
        else:
            columns += [vectors[:, k].real, vectors[:, k].imag]
            k += 2
    T = np.array(columns).T
    A, B, C = np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T
    k = 0
    while k < len(A):
        size = 2 if k + 1 < len(A) and abs(A[k, k + 1]) > 1e-9 else 1
        block = slice(k, k + size)
        scale = np.sqrt(np.linalg.norm(B[block]) / np.linalg.norm(C[block]))
        B[block] /= scale
        C[block] *= scale
        k += size
    return np.where(np.abs(A) < 1e-12, 0.0, A), B, C


def stabilised(A: Array) -> Array:
    """`A` with each unstable pole reflected into the unit circle, the others untouched."""
    values, vectors = np.linalg.eig(A)
    outside = np.abs(values) >= 1.0
    if not outside.any():
        return A
    values[outside] = 1.0 / np.conj(values[outside])
    return np.asarray((vectors @ np.diag(values) @ np.linalg.inv(vectors)).real)


def fit_siso(u: Array, y: Array, order: int, delay: int, block_rows: int = 40, split: float = 0.75) -> SubspaceModel:
    """Model of `order` behind `delay` samples; `u`, `y` (n,) with their means taken off.

    Fitted on the first `split` of the record; ``fit_percent`` is the free run on the rest.
    """
    shifted_u, shifted_y = u[: len(u) - delay], y[delay:]
    count = int(split * len(shifted_u))
    left, values = observability(shifted_u[:count], shifted_y[:count], block_rows)
    gamma = left[:, :order]
    C = gamma[0]
    A = stabilised(np.asarray(lstsq(gamma[:-1], gamma[1:])[0]))
    # B enters the output linearly: one free run a state gives the regressors
    regressors = np.column_stack([simulate(A, column, C, shifted_u[:count]) for column in np.eye(order)])
    settle = min(count // 4, 2000)
    B = np.asarray(lstsq(regressors[settle:], shifted_y[settle:count])[0])
    A, B, C = modal(A, B, C)
    run = simulate(A, B, C, shifted_u)[count:]
    held_out = shifted_y[count:]
    error = np.linalg.norm(held_out - run) / np.linalg.norm(held_out - held_out.mean())
    return SubspaceModel(A, B, C, values, 100.0 * (1.0 - float(error)))
