"""What one axis does on a known deviation: set-point, stage and voltage, by the laws and the model of its file.

The loop is linear as long as no limit holds, so it is its responses from the deviation to set-point and stage
(``design/budget/loop.py``, with the tracker's predictor of ``design/budget/tracking.py`` in front), turned into impulse
responses and convolved with the path:

    u = R S T d,   y = G u,   error = d - y

with T from deviation to what the outer loop is given, R and Y its laws, G the model, S = 1 / (1 + G Y). What a limit
does once it holds is not in it: from there on less is reached. The voltage is that of the inverse on the set-point;
what the strain loop adds to it is the inverse's own error, a few volts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.design.budget.loop import AxisLaws
from micromanip.design.budget.tracking import Tracking
from micromanip.rt.laws.feedforward import (
    HYSTERESIS_PARAMETERS,
    HYSTERESIS_STATE,
    feedforward_voltage,
    start_feedforward,
)
from micromanip.settings.compile.hysteresis import fill_hysteresis
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.hysteresis import NoModel

Array = NDArray[np.float64]

MOST_HZ = 2000.0
"""Rate of the prediction: what a robot does is far below half of it, and of the loop's rate where that is lower."""
_MEMORY_S = 1.0
"""Length of the impulse responses: every mode of a tuned loop has died away by then."""
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
    to_setpoint, to_stage = _impulse_responses(laws, tracking, rate_hz)
    setpoint = laws.axis.centre_um + share * _convolved(to_setpoint, deviation_um)
    error = deviation_um - share * _convolved(to_stage, deviation_um)
    return Predicted(rate_hz, deviation_um, setpoint, error, inverse_voltage(laws.axis, park_V, setpoint, rate_hz))


def _impulse_responses(laws: AxisLaws, tracking: Tracking, rate_hz: float) -> tuple[Array, Array]:
    """From deviation to set-point and to stage, (n,) samples each, those before 0 s first."""
    length = 2 * round(0.5 * _MEMORY_S * rate_hz)
    hertz = np.fft.rfftfreq(length, 1.0 / rate_hz)
    hertz[0] = _STANDING_HZ
    omega = np.asarray(2.0 * np.pi * hertz, dtype=np.float64)
    loop = laws.around(laws.model(omega), omega)
    given = tracking.response(laws.gains.reference, omega) * np.exp(-1j * omega * tracking.latency_s) / tracking.every
    setpoint = loop.following * loop.sensitivity * given
    before = int(_AHEAD * length)
    found = []
    for response in (setpoint, loop.plant * setpoint):
        response[0] = response[0].real
        found.append(np.roll(np.fft.irfft(response, length), before))
    return found[0], found[1]


def _convolved(impulse: Array, values: Array) -> Array:
    from scipy.signal import oaconvolve

    after = int(_AHEAD * len(impulse))
    before = len(impulse) - after
    long = np.pad(values, (before, after), "reflect", reflect_type="odd")
    whole = np.asarray(oaconvolve(long, impulse))
    return whole[len(impulse) : len(impulse) + len(values)]


def inverse_voltage(axis: Axis, park_V: float, setpoint_um: Array, rate_hz: float) -> Array | None:
    """Voltage (n,) of the inverse hysteresis model on `setpoint_um` (n,), from `park_V` by way of the centre.

    None for an axis without one.
    """
    if isinstance(axis.hysteresis, NoModel) or axis.inner.mode == "pid":
        return None
    p, s = np.zeros(1, HYSTERESIS_PARAMETERS)[0], np.zeros(1, HYSTERESIS_STATE)[0]
    fill_hysteresis(p, axis.hysteresis, 1.0 / rate_hz)
    start_feedforward(p, s, axis.setpoint.range_um[0], park_V)
    approach = np.linspace(axis.setpoint.range_um[0], setpoint_um[0], max(2, round(_APPROACH_S * rate_hz)))
    for um in approach:
        feedforward_voltage(p, s, um)
    return np.array([feedforward_voltage(p, s, um) for um in setpoint_um])
