"""The loops of one axis while they are closed: plants as they are seen there, by a small multisine on the reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micromanip.control.outer_gains import OuterGains, outer_gains
from micromanip.control.system import Array, System
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import AT_ONCE

from ..experiment import Experiment, alone, path_bandwidth, play, resting, within_slew
from .response import Measured, Multisine, measure, multisine

_LOW_HZ, _SHARE, _WIDEST_HZ = 12.0, 0.4, 4000.0
_STRAIN_UM = ((150.0, 0.5), (600.0, 0.35), (_WIDEST_HZ, 0.25))
_STAGE_UM = ((150.0, 0.35), (600.0, 0.6), (1500.0, 0.8), (2500.0, 0.6), (_WIDEST_HZ, 0.2))
"""Of the set-point: most where the stage hardly follows it, and a fast filter still asks for much."""
_STAGE_LATE_UM = ((150.0, 0.7), (600.0, 1.2), (1500.0, 0.5), (_WIDEST_HZ, 0.2))
"""The same behind a bus, as the stage was identified: its lines end where the plain one only begins to play more."""
_SLEW_SHARE, _LEAD_S = 0.6, 1.0


def measure_strain_loop(configuration: Configuration, experiment: Experiment, axis: str, seed: int = 1) -> Measured:
    """Voltage to gauge while the strain loop is closed about the working point, the others parked."""
    wave, samples = _excitation(configuration, experiment, axis, _STRAIN_UM, seed)
    return _played(configuration, experiment, axis, "strain", wave, samples, ("voltage_V", "strain_um"))


def measure_outer_loop(configuration: Configuration, experiment: Experiment, axis: str, seed: int = 1) -> Measured:
    """Set-point to stage sensor while the outer loop is closed, the others parked."""
    outer, index = configuration.axes[axis].outer, list(configuration.axes).index(axis)
    if outer is None:
        raise ValueError(f"axis {axis} has no outer loop")
    rms = _STAGE_UM if experiment.path(configuration, axis) == AT_ONCE else _STAGE_LATE_UM
    wave, samples = _excitation(configuration, experiment, axis, rms, seed)
    gains = outer_gains(outer, None, configuration.loop.period_ns * 1e-9)
    controllable = len(outer.model.A) + outer.model.delay_cycles
    # the stage's reference is relative to the working point
    moved = samples[:, index] - configuration.axes[axis].centre_um
    samples[:, index] = reference_for(moved, gains, controllable, configuration.loop.rate_hz)
    return _played(configuration, experiment, axis, "stage", wave, samples, ("setpoint_um", "stage_um"))


def _excitation(
    configuration: Configuration, experiment: Experiment, axis: str, rms: tuple[tuple[float, float], ...], seed: int
) -> tuple[Multisine, NDArray[np.float64]]:
    rate_hz = configuration.loop.rate_hz
    wide_hz = min(rms[-1][0], _SHARE * rate_hz, path_bandwidth(experiment.path(configuration, axis), rate_hz))
    wave = multisine(rms, _LOW_HZ, wide_hz, rate_hz, seed=seed, lead_s=_LEAD_S)
    samples = resting(configuration, axis, len(wave.samples))
    samples[:, list(configuration.axes).index(axis)] += within_slew(configuration, axis, wave.samples, _SLEW_SHARE)
    return wave, samples


def reference_for(setpoint_um: Array, gains: OuterGains, controllable: int, rate_hz: float) -> Array:
    """The reference (n,) for which the closed loop, by its model, moves the set-point as given.

    ``u = G w - K x`` with the velocity as it is played. Regulators differ in these gains by orders of magnitude, and a
    mode that K damps would be left out of the set-point; what the plant sees must not depend on that.
    """
    count = 2 * len(setpoint_um)  # what rings on comes back at the other end
    omega = 2.0 * np.pi * rate_hz * np.asarray(np.fft.rfftfreq(count), dtype=np.float64)
    A, B, K = (m[:controllable] for m in (gains.A[:, :controllable], gains.B, gains.feedback))
    fed_back = System(A, B, K, 0.0, 1.0 / rate_hz).response(omega)
    fed = gains.reference[0] + 1j * gains.reference[1] * rate_hz * np.sin(omega / rate_hz)
    spectrum = np.fft.rfft(setpoint_um, count) * (1.0 + fed_back) / fed
    return np.asarray(np.fft.irfft(spectrum, count)[: len(setpoint_um)])


def _played(
    configuration: Configuration,
    experiment: Experiment,
    axis: str,
    mode: str,
    wave: Multisine,
    samples: NDArray[np.float64],
    columns: tuple[str, str],
) -> Measured:
    rows = play(alone(configuration, axis, mode), experiment, samples)
    index = list(configuration.axes).index(axis)
    u, y = (np.asarray(rows[name][:, index], dtype=float) for name in columns)
    return measure(wave, u, y)
