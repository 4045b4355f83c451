"""Describing function of the inverse in closed form, equations (22)-(24), for identity and affine shaping.

With ``q_i = r_hat_i / A`` and ``x_i = 1 - 2 q_i``, over the plays that move (``A > r_hat_i``):

    a1/A = 1/alpha + sum rho_hat_i [1/2 + (asin x_i + x_i sqrt(1 - x_i^2)) / pi]
    b1/A = -(4/pi) sum rho_hat_i q_i (1 - q_i)

which is (23) and (24) with ``theta_i = pi - asin x_i`` put in. An affine shaping divides both by its slope.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micromanip.settings.schema.hysteresis import PrandtlIshlinskii

from .operator import Array, inverse_operator


def closed_form(model: PrandtlIshlinskii, amplitude_um: Array) -> NDArray[np.complex128]:
    """``N(A) = (a1 + i b1)/A`` in V/um for amplitudes (k,); the offset does not matter for these shapings.

    Raises ValueError for tanh and table shaping, for which only the quadrature exists.
    """
    if model.shaping not in ("identity", "affine"):
        raise ValueError(f"(22)-(24) hold for identity and affine shaping, not for {model.shaping}: use the quadrature")
    amplitude = np.asarray(amplitude_um, dtype=float)
    if not (amplitude > 0).all():
        raise ValueError("amplitudes must be positive")
    operator = inverse_operator(model)
    q = np.minimum(operator.thresholds / amplitude[:, None], 1.0)
    x = 1.0 - 2.0 * q
    # at q = 1 both terms are 0: the plays that rest drop out by themselves, as by Gamma of (22)
    in_phase = 0.5 + (np.arcsin(x) + x * np.sqrt(1.0 - x * x)) / np.pi
    slope = model.coefficients[0] if model.shaping == "affine" else 1.0
    a1 = operator.gain + in_phase @ operator.weights
    b1 = -4.0 / np.pi * (q * (1.0 - q)) @ operator.weights
    return np.asarray((a1 + 1j * b1) / slope)
