"""What may be injected into a loop of a configuration: where, how large, up to which frequency."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from micromanip.control.injection import Injection, highest_Hz, injection
from micromanip.control.outer_gains import outer_gains
from micromanip.control.stage_loop import model_system, stage_loop
from micromanip.errors import CheckFailed, require_axis

from .schema.axis import Axis
from .schema.model import Configuration
from .wiring.timing import FeedbackPath, path_bandwidth

AMPLITUDE_UM = 0.3
"""Rms by default: some noises of a gauge."""
COLUMNS = {"strain": ("voltage_V", "strain_um"), "stage": ("setpoint_um", "stage_um")}
"""What goes into the plant of each loop and what comes out, in the rows."""
_SLEW_SHARE = 0.5
_MOST_SUPPRESSED = 4.0
"""So much more of a line is played at most: the model may be wrong, and nothing be taken away."""
Array = NDArray[np.float64]


def plan_excitation(
    configuration: Configuration, path: FeedbackPath, axis: str, loop: str, amplitude_um: float, seed: int
) -> Injection:
    """The injection for `loop` of `axis`, `amplitude_um` rms on the actuator's set-point.

    Raises UsageError where there is no such axis, CheckFailed where that loop is not closed, or the amplitude
    asks for more than half of the set-point's slew limit.
    """
    require_axis(axis, configuration.axes)
    settings = configuration.axes[axis]
    if settings.mode == "voltage" or (loop == "stage" and settings.mode != "stage"):
        raise CheckFailed(f"sensitivity refused: axis {axis} is in mode {settings.mode}, its {loop} loop is open")
    if loop == "strain" and settings.inner.mode == "feedforward":
        raise CheckFailed(f"sensitivity refused: inner.mode of axis {axis} is feedforward, its strain loop is open")
    rate_hz = float(configuration.loop.rate_hz)
    high_Hz = highest_Hz(rate_hz, path_bandwidth(path, rate_hz))
    taken = partial(_suppressed, configuration, settings)
    wave = injection(amplitude_um, high_Hz, rate_hz, seed=seed, suppressed=taken)
    allowed = _SLEW_SHARE * settings.setpoint.slew_um_per_ms * 1e3 / rate_hz
    if wave.fastest > allowed:
        raise CheckFailed(
            f"sensitivity refused: {amplitude_um:g} um rms would move axis {axis} at "
            f"{100 * _SLEW_SHARE * wave.fastest / allowed:.0f} % of setpoint.slew_um_per_ms; at most "
            f"{amplitude_um * allowed / wave.fastest:.2g} um"
        )
    return wave


def _suppressed(configuration: Configuration, settings: Axis, hertz: Array) -> Array:
    """How much less (k,) the set-point moves than what is added to it, as the outer loop answers it: |1 + L|.

    By its own model. It is most at the stage's modes, of which the most is asked, and which it would hide.
    """
    outer = settings.outer
    if settings.mode != "stage" or outer is None:
        return np.ones(len(hertz))
    period_s = configuration.loop.period_ns * 1e-9
    loop = stage_loop(outer_gains(outer, None, period_s), model_system(outer.model, period_s), outer.sample_cycles)
    shown = hertz < 0.5 / loop.period_s
    left = np.abs(1.0 + loop.response(2.0 * np.pi * np.where(shown, hertz, 0.0)))
    return np.asarray(np.where(shown, np.clip(left, 1.0, _MOST_SUPPRESSED), 1.0))
