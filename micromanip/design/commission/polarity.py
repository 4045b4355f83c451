"""Sensors at rest, and the first move of all: does the axis move, which way, how far, and does the right gauge see it?

Open loop and small: a wrong sign or a crossed cable would make every later feedback run away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.rt.telemetry import DEVIATION_FRESH, STRAIN_FRESH
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker

from ..excitation import half_cosine
from ..experiment import Experiment, open_loop, parked, play

# A gauge that is dead, flagged or on its rail would let a strain loop run away. The capacitive sensor may be at the end
# of its range where the stage rests: ``stage_sensor_check.py`` judges it, still in open loop.


REST_S = 0.3
_PRESENT, NOISY = 0.5, 0.005
"""Share of the expected samples that must come; rms at rest, as a share of the sensor's way over the set-points."""
_HUM = 0.5
"""Share of that rms which one line must have to be called by its frequency."""
_FRESH = {"strain": ("strain gauge", STRAIN_FRESH), "deviation": ("tracker", DEVIATION_FRESH)}


def check_rest(configuration: Configuration, experiment: Experiment, axis: str) -> None:
    """Look at the sensors of `axis` with every output parked; raises CheckFailed where one can't be trusted."""
    still = parked(configuration, round(REST_S * configuration.loop.rate_hz))
    rows = play(open_loop(configuration), experiment, still)
    of_axis = rows[:, list(configuration.axes).index(axis)]
    path, tracked = experiment.path(configuration, axis), isinstance(configuration.reference, Tracker)
    expected = {"strain": len(rows) / max(path.strain_cycles, 1), "deviation": 2.0}
    for role in ("strain", "deviation") if tracked else ("strain",):
        _require_samples(axis, role, of_axis, expected[role])
    strain = _fresh(of_axis, "strain")
    signal = configuration.signals[f"strain_{axis}"]
    at_end = signal.range_um is not None and strain[0] in signal.range_um
    if np.ptp(strain) == 0.0 and (at_end or configuration.faults.axis.strain.identical is not None):
        raise CheckFailed(
            f"axis {axis}: at rest the strain gauge reads exactly {strain[0]:g} um all the time, without any "
            f"noise{', an end of its range' if at_end else ''}: it is dead, not connected or on its rail; check its "
            f"supply, cable and zero, and signals.strain_{axis}. Where it is merely coarser than its noise, "
            "faults.axis.strain.identical: null says so. Nothing was moved or closed"
        )
    low, high = configuration.axes[axis].setpoint.range_um
    require_quiet(axis, "strain gauge", strain, high - low, REST_S)


def require_quiet(axis: str, sensor: str, at_rest: Array, way_um: float, seconds: float) -> None:
    """Raise CheckFailed where a sensor's samples (n,) of `seconds` vary too much for the `way_um` to measure."""
    noise_um = float(at_rest.std()) if len(at_rest) else 0.0
    if noise_um > NOISY * way_um:
        power = np.abs(np.fft.rfft(at_rest - at_rest.mean())) ** 2
        k = int(np.argmax(power))
        line = power[max(0, k - 1) : k + 2].sum() > _HUM * power.sum()
        most = f"most of it at {k / seconds:.0f} Hz: hum or a vibration" if line else "an open input or a disturbance"
        raise CheckFailed(
            f"axis {axis}: at rest the {sensor} moves by {noise_um:.2g} um rms, {most}; at most {NOISY * way_um:.2g} "
            f"um, {100 * NOISY:g} % of its way over the set-points, would do: check its cable, shield and ground. "
            "No loop was closed"
        )


def _fresh(of_axis: NDArray[Any], role: str) -> Array:
    return np.asarray(of_axis[f"{role}_um"][(of_axis["fresh"] & _FRESH[role][1]) != 0], dtype=float)


def _require_samples(axis: str, role: str, of_axis: NDArray[Any], expected: float) -> None:
    came = len(_fresh(of_axis, role))
    if came < _PRESENT * expected:
        raise CheckFailed(
            f"axis {axis}: the {_FRESH[role][0]} gives {came or 'no'} usable samples in {REST_S:g} s at rest, "
            f"{_PRESENT * expected:.0f} would do: none come, or they are late, no numbers, flagged as invalid, or "
            f"outside signals.{role}_{axis}.range_um; `micromanip device probe CONFIG` shows it. No loop was closed"
        )


MOVE_SHARE = 0.12
"""Of the output's range: about 20 V, 13 um."""
_RISE_S, _HOLD_S = 0.5, 0.3
_LEAST, _MOST, _SMALL = 0.05, 5.0, 0.01
_ACROSS = 0.3
_NOISES = 8.0


@dataclass(frozen=True)
class Polarity:
    """Slope (um/V) of the axis' own gauge, and how far (um) every gauge moved with the axis' `moved_V`."""

    slope_um_per_V: float
    moved_V: float
    moved_um: dict[str, float]
    noise_um: float = 0.0
    """Rms of the own gauge at rest."""

    def share(self, other: str, axis: str) -> float:
        """How far gauge `other` moved, in terms of the own one of `axis`."""
        return abs(self.moved_um[other] / self.moved_um[axis])


def check_polarity(configuration: Configuration, experiment: Experiment, axis: str) -> Polarity:
    """Move `axis` a little up from its park voltage and back; raises CheckFailed where that looks wrong."""
    output, rate_hz = configuration.outputs[f"voltage_{axis}"], configuration.loop.rate_hz
    names = list(configuration.axes)
    move_V = MOVE_SHARE * (output.range_V[1] - output.range_V[0])
    if output.park_V + move_V > output.range_V[1]:
        move_V = -move_V
    rise, hold = round(_RISE_S * rate_hz), round(_HOLD_S * rate_hz)
    ramp = half_cosine(rise)
    shape = np.concatenate([np.zeros(hold), ramp, np.ones(hold), ramp[::-1]])
    samples = parked(configuration, len(shape))
    samples[:, names.index(axis)] += move_V * shape
    strain = play(open_loop(configuration), experiment, samples)["strain_um"]
    before, after = strain[hold // 4 : hold], strain[hold + rise + hold // 4 : 2 * hold + rise]
    moved = {name: float(after[:, i].mean() - before[:, i].mean()) for i, name in enumerate(names)}
    noise_um = {name: float(before[:, i].std()) for i, name in enumerate(names)}
    return judged(axis, move_V, moved, noise_um)


def judged(axis: str, move_V: float, moved: dict[str, float], noise_um: dict[str, float]) -> Polarity:
    """What the gauges' movements mean; CheckFailed with what to do where the axis must not be closed."""
    slope = moved[axis] / move_V
    seen = f"axis {axis}: {move_V:+.0f} V moved its strain gauge by {moved[axis]:+.2f} um"
    others = {name: value for name, value in moved.items() if name != axis}
    if others:
        other = max(others, key=lambda name: abs(others[name]))
        if abs(others[other]) > _NOISES * noise_um[other] and abs(others[other]) > max(3.0 * abs(moved[axis]), 0.5):
            raise CheckFailed(
                f"{seen}, but that of axis {other} by {others[other]:+.2f} um: the gauges or the outputs are swapped; "
                "check cables and the channels in the sections signals and outputs. Nothing was closed"
            )
    if _NOISES * noise_um[axis] < abs(moved[axis]) < _LEAST * abs(move_V) and abs(slope) < _SMALL:
        raise CheckFailed(
            f"{seen}, {slope:.2g} um/V, far above its noise of {noise_um[axis]:.2g} um: a gauge that reads too little, "
            f"{_LEAST:g} um/V at least are a piezo's; check its scale and unit (mm for um?). Nothing was closed"
        )
    least_um = max(_NOISES * noise_um[axis] / 10.0, _LEAST * abs(move_V))
    if abs(moved[axis]) < least_um:
        raise CheckFailed(
            f"{seen}, at least {least_um:.2g} um are needed: the actuator does not move, or the gauge does not see "
            "it; check the amplifier's enable and fuse, and the gauge's supply. Nothing was closed"
        )
    if slope < 0.0:
        raise CheckFailed(
            f"{seen}: the wrong way, feedback would run away; swap the gauge's leads, or change the sign of its "
            "scale. Nothing was closed"
        )
    if slope > _MOST:
        raise CheckFailed(
            f"{seen}, {slope:.2g} um/V: more than {_MOST:g} um/V is no piezo actuator; check the gauge's scale and "
            "unit. Nothing was closed"
        )
    if others and abs(others[other]) > _ACROSS * abs(moved[axis]):
        raise CheckFailed(
            f"{seen}, and that of axis {other} by {others[other]:+.2f} um: more than {100 * _ACROSS:.0f} % across; "
            "look for a loose flexure or a gauge on the wrong stack. Nothing was closed"
        )
    return Polarity(slope, move_V, moved, noise_um[axis])
