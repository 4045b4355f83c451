"""What no causal controller with these sensors can beat: the error of the best prediction from noisy, late samples.

A controller that knows the spectrum of what comes, path or force, sees it in samples ``s_i = x(t_i) + n_i`` and moves
the stage a dead time later: at best it moves it to the conditional mean of x then. What is left is

    var = r(0) - k' (K + s^2 I)^-1 k,   K_ij = r(t_i - t_j),   k_i = r(t - t_i)

(Wiener's prediction for a memory of some length; Rasmussen and Williams, Gaussian Processes, equation (2.26)). r is the
autocovariance of sines whose phase nobody knows for longer than a coherence time, ``A^2/2 cos(w t) exp(-(t/c)^2 / 2)``:
a pure sine could be learnt for ever, and the bound would be nothing. It assumes that the process is Gaussian and
the actuator has no other limit than its dead time; what the gauges tell of the force is neglected.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz

Array = NDArray[np.float64]

_MEMORY = 3.0
"""Coherence times that the samples go back."""
_MOST = 1500
"""Samples that are looked at."""


def autocovariance(hertz: Array, power: Array, coherence_s: float, step_s: float, count: int, after_s: Array) -> Array:
    """The function r (count, m), um^2, of sines of `hertz` (k,) and `power` (k,), at lags from `after_s` (m,) on.

    The phase at a lag is that of its block of lags and that within it: few are computed, the rest is a product.
    """
    some = power > 1e-12 * power.max(initial=0.0)
    omega = 2.0 * np.pi * hertz[some]
    block = int(np.ceil(np.sqrt(count)))
    within, blocks = (np.exp(1j * np.outer(each * step_s * np.arange(block), omega)) for each in (1, block))
    found = [((blocks * (power[some] * np.exp(1j * omega * after))) @ within.T).real.ravel() for after in after_s]
    lags_s = step_s * np.arange(count)[:, None] + after_s
    return np.asarray(np.array(found).T[:count] * np.exp(-0.5 * (lags_s / coherence_s) ** 2))


def prediction_variance(
    hertz: Array, power: Array, coherence_s: float, noise_variance: float, step_s: float, ahead_s: Array
) -> float:
    """Mean over `ahead_s` (m,) of the variance (um^2) that is left of a prediction so far beyond the newest sample."""
    count = int(min(_MOST, max(2.0, _MEMORY * coherence_s / step_s)))
    found = autocovariance(hertz, power, coherence_s, step_s, count, np.append(0.0, ahead_s))
    row, asked = found[:, 0], found[:, 1:]
    row[0] += noise_variance
    known = np.sum(asked * solve_toeplitz(row, asked), axis=0)
    return float(max(np.mean(float(np.sum(power)) - known), 0.0))
