"""Linear dynamics of one actuator, voltage to strain gauge, about its working point: what the strain loop closes over.

Recorded in open loop with a small periodic multisine, the other axes at rest; more of it where the flexure's modes and
antiresonances lie side by side. Small, so that the hysteresis adds little: its slope over amplitude is the describing
function's business. Measured again, with more draws of the phases and more voltage, where the response or its model is
not good enough: the mean of many has less noise, on every line alike, and less of what is not linear, which longer
periods leave as it is (Pintelon and Schoukens, System Identification, 2nd ed., chapter 4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from micromanip.control.system import System
from micromanip.errors import CheckFailed
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import AT_ONCE, FeedbackPath

from ..experiment import Experiment, alone, open_loop, parked, path_bandwidth, play, require_answer, resting
from .response import Identified, Recorded, Wanted, identify_again, multisine

LOW_HZ, WIDE_HZ = 12.0, 4000.0
"""Below it creep and hysteresis, not the linear dynamics, make the movement."""
_RMS_V = ((150.0, 1.0), (600.0, 0.6), (WIDE_HZ, 0.7))
"""Upper frequency and rms of each part."""
_WIDEST_SHARE = 0.4
ORDERS, DELAYS = tuple(range(4, 17)), tuple(range(7))
NARROW_HZ, NARROW_ORDERS = 1000.0, (3, 4, 5, 6)
"""Behind a slow bus less of the actuator is seen: its first mode, the antiresonance beside it, one lag."""
_MORE = 1.4
"""What each attempt is larger by."""
_DRAWS = 2
"""Of the phases, in the first attempt."""
_SETTLE_S = 0.5


@dataclass(frozen=True)
class Actuator:
    """Voltage (V) to strain gauge (um), a step per cycle, for swings near ``swing_um``, and what it was found from."""

    found: Identified
    swing_um: float
    centre_V: float
    path: FeedbackPath = AT_ONCE
    """What a bus adds between the two, which is not in ``dynamics``."""
    attempts: int = 1
    branch_um_per_V: float = 0.0
    """Steepest slope along a branch, where a slow record of the whole stroke has shown it."""

    @cached_property
    def dynamics(self) -> System:
        """The model, its delay (cycles) left out."""
        return self.found.dynamics()

    @property
    def delay(self) -> int:
        """Whole cycles from a voltage to the first of its answer, beyond that of the dynamics."""
        return self.found.delay

    @cached_property
    def system(self) -> System:
        """The model with its delay."""
        return self.found.system()


def working_voltage(configuration: Configuration, experiment: Experiment, axis: str) -> float:
    """Voltage (V) that holds `axis` at its working point, under its own feedback; the others rest."""
    samples = resting(configuration, axis, round(_SETTLE_S * configuration.loop.rate_hz))
    rows = play(alone(configuration, axis, "strain"), experiment, samples)
    return float(rows["voltage_V"][len(rows) // 2 :, list(configuration.axes).index(axis)].mean())


def identify_actuator(
    configuration: Configuration, experiment: Experiment, axis: str, seed: int = 1, centre_V: float | None = None
) -> Actuator:
    """Record and fit about `centre_V`, by default the voltage that holds the working point.

    Raises CheckFailed where no response stands out of the noise, or the gauge has gaps.
    """
    rate_hz, index = configuration.loop.rate_hz, list(configuration.axes).index(axis)
    if centre_V is None:
        centre_V = working_voltage(configuration, experiment, axis)
    path = experiment.path(configuration, axis)
    wide_hz = min(WIDE_HZ, _WIDEST_SHARE * rate_hz, path_bandwidth(path, rate_hz))
    narrow = wide_hz <= NARROW_HZ
    wanted = Wanted(NARROW_ORDERS if narrow else ORDERS, (0,) if narrow else DELAYS)
    range_V = configuration.outputs[f"voltage_{axis}"].range_V

    def record(attempt: int, more: int) -> Recorded:
        wave = multisine(
            tuple((upper, _MORE**attempt * rms) for upper, rms in _RMS_V),
            LOW_HZ,
            wide_hz,
            rate_hz,
            seed=seed + attempt,
            draws=_DRAWS * more,
        )
        samples = parked(configuration, len(wave.samples))
        samples[:, index] = centre_V + wave.samples
        reach = float(np.abs(wave.samples).max())
        if centre_V - reach < range_V[0] or centre_V + reach > range_V[1]:
            raise CheckFailed(
                f"axis {axis}: the working point is held by {centre_V:.1f} V, too near to the end of range_V for a "
                f"swing of {reach:.1f} V: move centre_um. Nothing was closed"
            )
        rows = play(open_loop(configuration), experiment, samples)
        u, y = (np.asarray(rows[name][:, index], dtype=float) for name in ("voltage_V", "strain_um"))
        require_answer(axis, "strain gauge", y)
        return wave, u, y

    tried = identify_again(
        record,
        wanted,
        f"axis {axis}: the actuator can't be identified",
        "Look for a loose gauge, or a disturbance meanwhile. Nothing was closed",
    )
    found = tried.found
    swing_um = float(
        _MORE ** (tried.attempts - 1)
        * np.sqrt(2.0 * sum(rms**2 for _, rms in _RMS_V))
        * np.median(np.abs(found.measured.response))
    )
    return Actuator(found, swing_um, centre_V, path, tried.attempts)
