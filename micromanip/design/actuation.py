"""Linear dynamics of one actuator, voltage to strain gauge, about its working point: what the strain loop closes over.

Recorded in open loop with small noise in two bands: the first mode and its antiresonance lie close together near
65 Hz and are seen only if much of the excitation is there; amplifier, gauge and the mode near 2.4 kHz need the rest.
Small, so that the hysteresis adds little: its slope over amplitude is the describing function's business.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from micromanip.control.system import System
from micromanip.errors import CheckFailed
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Hold
from micromanip.settings.wiring.timing import AT_ONCE, FeedbackPath

from .excitation import band_noise
from .experiment import Experiment, parked, path_bandwidth, with_axes, with_reference
from .identification import variant
from .linear import fit_linear

Array = NDArray[np.float64]

SECONDS, SETTLE_S = 4.0, 0.1
LOW_RMS_V, LOW_HZ = 1.0, 80.0
WIDE_RMS_V, WIDE_HZ = 0.7, 3000.0
ORDER, _BLOCK_ROWS, _REFINEMENTS = 8, 50, 3
NARROW_HZ, NARROW_ORDER = 1000.0, 5
"""Behind a slow bus less of the actuator is seen: its first mode, the antiresonance beside it, one lag."""
_DRIFT_HZ = 5.0
"""Below it creep and hysteresis, not the linear dynamics, make the movement."""
_LEAST_FIT_PERCENT = 50.0


@dataclass(frozen=True)
class Actuator:
    """``dynamics`` from voltage (V) to strain gauge (um), a step per cycle, for swings near ``swing_um``.

    ``fit_percent``: free run on the part of the record that was left out.
    """

    dynamics: System
    swing_um: float
    centre_V: float
    fit_percent: float
    path: FeedbackPath = AT_ONCE
    """What a bus adds between the two, which is not in ``dynamics``."""


def working_voltage(configuration: Configuration, experiment: Experiment, axis: str) -> float:
    """Voltage (V) that holds `axis` at its working point, under its own feedback."""
    index = list(configuration.axes).index(axis)
    held = Hold(source="hold", offset_um=configuration.axes[axis].centre_um)
    rows = experiment(with_reference(with_axes(configuration, mode="strain"), held), 0.5)
    return float(rows["axis"]["voltage_V"][len(rows) // 2 :, index].mean())


def identify_actuator(configuration: Configuration, experiment: Experiment, axis: str, seed: int = 1) -> Actuator:
    """Record and fit; raises CheckFailed where the record does not look like an actuator."""
    rate_hz = configuration.loop.rate_hz
    centre_V = working_voltage(configuration, experiment, axis)
    count, index = round(SECONDS * rate_hz), list(configuration.axes).index(axis)
    samples = parked(configuration, count)
    path = experiment.path(configuration, axis)
    wide_hz = min(WIDE_HZ, 0.3 * rate_hz, path_bandwidth(path, rate_hz))
    noise = band_noise(LOW_RMS_V, LOW_HZ, rate_hz, count, seed)
    samples[:, index] = centre_V + noise + band_noise(WIDE_RMS_V, wide_hz, rate_hz, count, seed + 1)
    rows = experiment(variant(configuration), SECONDS, samples)[round(SETTLE_S * rate_hz) :]["axis"]
    u, y = (np.asarray(rows[name][:, index], dtype=float) for name in ("voltage_V", "strain_um"))
    fitted = fit_actuator(u, y, 1.0 / rate_hz, ORDER if wide_hz > NARROW_HZ else NARROW_ORDER)
    return Actuator(fitted.dynamics, fitted.swing_um, centre_V, fitted.fit_percent, path)


def fit_actuator(voltage_V: Array, strain_um: Array, period_s: float, order: int = ORDER) -> Actuator:
    """Dynamics from a record (n,), (n,) with a sample per cycle, excited by small noise about one voltage."""
    if len(voltage_V) != len(strain_um) or not (np.isfinite(voltage_V).all() and np.isfinite(strain_um).all()):
        raise CheckFailed("voltage and strain must be two finite records of one length")
    if voltage_V.std() == 0.0 or strain_um.std() == 0.0:
        raise CheckFailed("the record does not move: is the excitation on this axis, and the strain gauge connected?")
    drift = butter(2, _DRIFT_HZ, "high", fs=1.0 / period_s, output="sos")
    u, y = (sosfiltfilt(drift, signal)[:, None] for signal in (voltage_V, strain_um))
    part = 3 * len(u) // 4
    model = fit_linear(
        [(u[:part], y[:part])],
        period_s,
        order,
        delays=[0],  # the states of order 8 hold it: less than two cycles, of which a part is none
        direct=False,
        block_rows=_BLOCK_ROWS,
        refinements=_REFINEMENTS,
    )
    fit_percent = float(model.errors(u[part:], y[part:])[0][0])
    if fit_percent < _LEAST_FIT_PERCENT:
        raise CheckFailed(
            f"the strain gauge follows the voltage too little for a model: the free run on held-out data fits "
            f"{fit_percent:.0f} %, at least {_LEAST_FIT_PERCENT:.0f} % are needed; is it the right axis?"
        )
    A, B, C, _ = model.modes.state_space()
    swing_um = float(np.sqrt(2.0) * y.std())
    return Actuator(System(A, B[:, 0], C[0], 0.0, period_s), swing_um, float(voltage_V.mean()), fit_percent)
