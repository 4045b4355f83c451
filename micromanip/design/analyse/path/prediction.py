"""What one axis does on a known deviation: set-point, stage and voltage, by the laws and the model of its file.

What the tracker's predictor makes of the path, r, is stepped as the loop steps it (``budget/tracking.py``):
where it follows the joints' frequencies it is not linear. Behind it the loop is, as long as no limit holds, so the rest
is its responses to set-point and stage (``budget/loop.py``), turned into impulse responses and convolved with r:

    u = R S r,   y = G u,   error = d - y

with R and Y the laws of the outer loop, G the model, S = 1 / (1 + G Y). What a limit does once it holds is not in it:
from there on less is reached. The voltage is that of the inverse on the set-point; what the strain loop adds to it is
the inverse's own error, a few volts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micromanip.control.system import Array
from micromanip.design.analyse.budget.loop import AxisLaws
from micromanip.design.analyse.budget.tracking import Tracking
from micromanip.design.identify.hysteresis import inverse
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.hysteresis import NoModel

MOST_HZ = 2000.0
"""Rate of the prediction: what a robot does is far below half of it, and of the loop's rate where that is lower."""
_MEMORY_S = 1.0
"""Length of the impulse responses: every mode of a tuned loop has died away by then."""
_SETTLED_S = 3.0
"""How long before the path the predictor begins: by then it has found what swings."""
_AHEAD = 0.25
"""Share of that length kept for what comes before: a response that is cut at half the rate rings both ways."""
_STANDING_HZ = 1e-3
"""In the place of 0 Hz, where the integral action has no finite response."""
_APPROACH_S = 0.5


@dataclass(frozen=True)
class Predicted:
    """One axis at each instant (n,), `rate_Hz`: um, and V (None without an inverse); errors are path minus stage."""

    rate_Hz: float
    deviation_um: Array
    setpoint_um: Array
    error_um: Array
    voltage_V: Array | None


def predict(laws: AxisLaws, tracking: Tracking, park_V: float, deviation_um: Array, rate_hz: float) -> Predicted:
    """The axis on `deviation_um` (n,), `rate_hz` of them a second.

    It is under way when the path begins, and when it ends: what lies beyond is the path itself turned about its end.
    """
    share = laws.axis.authority_percent / 100.0
    now_s, given = _given(laws, tracking, deviation_um, rate_hz)
    time_s = np.arange(len(deviation_um)) / rate_hz
    moved, stage = (
        share * np.interp(time_s, now_s, _convolved(impulse, given)) for impulse in _impulse_responses(laws, tracking)
    )
    setpoint = laws.axis.centre_um + moved
    voltage = inverse_voltage(laws.axis, park_V, setpoint, rate_hz)
    return Predicted(rate_hz, deviation_um, setpoint, deviation_um - stage, voltage)


def _given(laws: AxisLaws, tracking: Tracking, deviation_um: Array, rate_hz: float) -> tuple[Array, Array]:
    """What the outer loop is given, (n,) cycles and when: from before the path's beginning to behind its end."""
    before, after = round((_SETTLED_S + _MEMORY_S) * rate_hz), round(_MEMORY_S * rate_hz)
    path = np.pad(deviation_um, (before, after), "reflect", reflect_type="odd")
    path_s = (np.arange(len(path)) - before) / rate_hz
    now_s = np.arange(path_s[0], path_s[-1], laws.period_s)
    taken_s = now_s[:: tracking.every]
    samples = np.interp(taken_s, path_s, path)
    return now_s, tracking.stepped(taken_s, taken_s + tracking.latency_s, samples, now_s, laws.gains.reference)[0]


def _impulse_responses(laws: AxisLaws, tracking: Tracking) -> tuple[Array, Array]:
    """From what the outer loop is given to set-point and stage, (n,) cycles each, those before 0 s first.

    Beyond half of the tracker's rate there are only images of what it saw, which are not shown.
    """
    length = 2 * round(0.5 * _MEMORY_S / laws.period_s)
    hertz = np.fft.rfftfreq(length, laws.period_s)
    hertz[0] = _STANDING_HZ
    omega = np.asarray(2.0 * np.pi * hertz, dtype=np.float64)
    loop = laws.around(laws.model(omega), omega)
    setpoint = loop.following * loop.sensitivity
    before = int(_AHEAD * length)
    found = []
    for response in (setpoint, loop.plant * setpoint):
        response[0] = response[0].real
        response[hertz > 0.5 / (tracking.every * laws.period_s)] = 0.0
        found.append(np.roll(np.fft.irfft(response, length), before))
    return found[0], found[1]


def _convolved(impulse: Array, values: Array) -> Array:
    from scipy.signal import oaconvolve

    ahead = int(_AHEAD * len(impulse))
    return np.asarray(oaconvolve(values, impulse))[ahead : ahead + len(values)]


def inverse_voltage(axis: Axis, park_V: float, setpoint_um: Array, rate_hz: float) -> Array | None:
    """Voltage (n,) of the inverse hysteresis model on `setpoint_um` (n,), from `park_V` by way of the centre.

    None for an axis without one.
    """
    if isinstance(axis.hysteresis, NoModel) or axis.inner.mode == "pid":
        return None
    begin_um = axis.setpoint.range_um[0]
    approach = np.linspace(begin_um, setpoint_um[0], max(2, round(_APPROACH_S * rate_hz)))
    return inverse(axis.hysteresis, np.concatenate([approach, setpoint_um]), 1.0 / rate_hz, park_V)[len(approach) :]
