"""Kalman filter of one axis: predicts in every cycle, updates only on a fresh sample, at its own age.

Model per cycle ``x+ = A x + B u``, ``y = C x``: identified dynamics, actuation delay, random-walk
input disturbance and tooth-passing oscillator; u is the actuator set-point that was really given
(after its limits), relative to the working point, y the capacitive sensor, both in um.

``filtered`` is the estimate at the cycle of the last fresh sample, ``x`` its prediction to now.
A sample taken `age` cycles ago is applied where it belongs: ``filtered`` is carried to the
sample's cycle with the set-points remembered, corrected there, and predicted to now again. The
gain is the stationary one for the sensor's sampling interval; the error dynamics
``(I - L C) A^m`` are checked to be stable with the configuration.
"""

from __future__ import annotations

from typing import Any

from .jit import compiled
from .records import INPUT_HISTORY, Record

_MASK = INPUT_HISTORY - 1


@compiled
def predict(p: Record, x: Any, scratch: Any, u: float) -> None:
    """One cycle of the model: ``x <- A x + B u``.

    Four states at a time over the padded length, their sums in registers: the compiler can't know that `scratch` lies
    apart from `p`, and turns only sums that it need not store at each term into vector instructions. The padding is
    zero and stays zero.
    """
    a, b = p["a_columns"], p["b"]
    for i in range(0, p["states"], 4):
        s0, s1, s2, s3 = b[i] * u, b[i + 1] * u, b[i + 2] * u, b[i + 3] * u
        for j in range(p["states"]):
            s0 += a[j, i] * x[j]
            s1 += a[j, i + 1] * x[j]
            s2 += a[j, i + 2] * x[j]
            s3 += a[j, i + 3] * x[j]
        scratch[i], scratch[i + 1], scratch[i + 2], scratch[i + 3] = s0, s1, s2, s3
    for i in range(p["states"]):
        x[i] = scratch[i]


@compiled
def output(p: Record, x: Any) -> float:
    """``C x``: the sensor reading (um) that the estimate `x` expects."""
    y = 0.0
    for i in range(p["states"]):
        y += p["c"][i] * x[i]
    return y


@compiled
def _advance(p: Record, s: Record, x: Any, first: int, last: int) -> None:
    for cycle in range(first, last):
        predict(p, x, s["scratch"], s["history"][cycle & _MASK])


@compiled
def start_estimator(p: Record, s: Record, cycle: int, u: float, y: float) -> None:
    """State at rest that agrees with set-point `u` held and sensor reading `y`."""
    for i in range(p["states"]):
        s["filtered"][i] = p["steady_u"][i] * u + p["steady_y"][i] * y
        s["x"][i] = s["filtered"][i]
    for k in range(INPUT_HISTORY):
        s["history"][k] = u
    s["filtered_cycle"] = cycle
    s["cycle"] = cycle
    s["innovation_um"] = 0.0
    s["running"] = 1


@compiled
def remember(s: Record, u: float) -> None:
    """Note the set-point `u` that is given in the present cycle."""
    s["history"][s["cycle"] & _MASK] = u


@compiled
def predict_to(p: Record, s: Record, cycle: int) -> None:
    """Carry ``x`` to `cycle`; cycles that an overrun skipped held the set-point before them."""
    held = s["history"][s["cycle"] & _MASK]
    for skipped in range(s["cycle"] + 1, min(cycle, s["cycle"] + INPUT_HISTORY)):
        s["history"][skipped & _MASK] = held
    _advance(p, s, s["x"], max(s["cycle"], cycle - INPUT_HISTORY + 1), cycle)
    s["cycle"] = cycle


@compiled
def update(p: Record, s: Record, sample_cycle: int, y: float) -> bool:
    """Apply the sample `y` taken at `sample_cycle`; False where it is too old to be of use.

    ``x`` must have been carried to the present cycle. A sample not younger than the one before is
    refused (out of order); after a gap longer than the memory the filter starts anew.
    """
    now = s["cycle"]
    if sample_cycle <= s["filtered_cycle"] or sample_cycle > now or now - sample_cycle >= INPUT_HISTORY:
        return False
    if now - s["filtered_cycle"] >= INPUT_HISTORY:
        start_estimator(p, s, now, s["history"][(now - 1) & _MASK], y)
        return True
    n = p["states"]
    if sample_cycle == now:
        for i in range(n):
            s["filtered"][i] = s["x"][i]
    else:
        _advance(p, s, s["filtered"], s["filtered_cycle"], sample_cycle)
    innovation = y - output(p, s["filtered"])
    for i in range(n):
        s["filtered"][i] += p["gain"][i] * innovation
        s["x"][i] = s["filtered"][i]
    _advance(p, s, s["x"], sample_cycle, now)
    s["filtered_cycle"] = sample_cycle
    s["innovation_um"] = innovation
    return True
