"""What the user asks for, measured on the axis alone: sines on the gauge, a path and a step of the stage.

The sines stay inside the set-point's range, whatever it is; the other axes rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.settings.schema.model import Configuration

from ..evaluation import HOLD_S, SETTLE_S, WINDOW_S, Run, variant_of
from ..experiment import EXCITED, Experiment, alone, parked, play, with_reference

Array = NDArray[np.float64]
CONFIGS = ("A", "B", "C")
_PATH_SHARE, _PATH_UM, _PATH_S = 0.15, 20.0, 2.0


@dataclass(frozen=True)
class Asked:
    """The sine on the gauge (um): its middle and amplitude."""

    offset_um: float
    amplitude_um: float


def asked(configuration: Configuration, axis: str) -> Asked:
    """By the configuration's `accept`, inside the set-point's range."""
    settings = configuration.axes[axis]
    low, high = settings.setpoint.range_um
    room = 0.5 * (high - low)
    wanted = 0.5 * room if settings.accept.stroke_um is None else 0.5 * settings.accept.stroke_um
    return Asked(0.5 * (low + high), min(wanted, room))


def follow(configuration: Configuration, experiment: Experiment, axis: str) -> list[Run]:
    """Configurations A, B and C of `axis` with its own PID on every sine that is asked for."""
    sine, rate_hz, runs = asked(configuration, axis), configuration.loop.rate_hz, []
    index = list(configuration.axes).index(axis)
    for config in CONFIGS:
        only = alone(configuration, axis, "strain")
        variant = only.model_copy(update={"axes": only.axes | {axis: variant_of(only.axes[axis], config, True)}})
        for hertz in configuration.axes[axis].accept.frequencies_Hz:
            settle_s = max(SETTLE_S, 1.0 / hertz)
            samples = _wave(configuration, index, sine.offset_um, sine.amplitude_um, hertz, settle_s + WINDOW_S)
            rows = experiment(with_reference(variant, EXCITED), len(samples) / rate_hz, samples)
            runs.append(Run(config, hertz, rows[round(HOLD_S * rate_hz) :], round(settle_s * rate_hz), rate_hz))
    return runs


def path_error(configuration: Configuration, experiment: Experiment, axis: str) -> tuple[float, float]:
    """Rms (um) of reference minus stage on a slow sine, outer loop closed, and that sine's amplitude (um)."""
    settings, index = configuration.axes[axis], list(configuration.axes).index(axis)
    low, high = settings.setpoint.range_um
    amplitude_um = min(_PATH_UM, _PATH_SHARE * (high - low))
    hertz = min(settings.accept.frequencies_Hz)
    samples = _wave(configuration, index, 0.0, amplitude_um, hertz, max(_PATH_S, 2.0 / hertz))
    rows = play(alone(configuration, axis, "stage"), experiment, samples)[:, index]
    late = rows[len(rows) // 2 :]
    return float(np.sqrt(np.mean((late["reference_um"] - late["stage_um"]) ** 2))), amplitude_um


def _wave(configuration: Configuration, index: int, middle: float, size: float, hertz: float, seconds: float) -> Array:
    """At rest at first, then the sine; the others parked."""
    rate_hz = configuration.loop.rate_hz
    t = np.arange(round((HOLD_S + seconds) * rate_hz)) / rate_hz - HOLD_S
    samples = parked(configuration, len(t))
    samples[:, index] = middle + np.where(t > 0.0, size * np.sin(2 * np.pi * hertz * t), 0.0)
    return samples
