"""How design gets its recordings: a callable that the command hands it, and variants of a configuration."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.rt.records import MAX_AXES
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import File, Reference
from micromanip.settings.wiring.timing import FeedbackPath
from micromanip.settings.wiring.timing import path_bandwidth as path_bandwidth


class Ended(CheckFailed):
    """A fault ended the experiment; `rows` are those up to it, and those in which the outputs went to rest."""

    def __init__(self, said: str, rows: NDArray[Any]) -> None:
        super().__init__(said)
        self.rows = rows


class Experiment(Protocol):
    """Runs a configuration, armed, without machining; telemetry rows of the `seconds` after tracking began."""

    def __call__(
        self,
        configuration: Configuration,
        seconds: float,
        samples: NDArray[np.float64] | None = None,
        every: int = 1,
    ) -> NDArray[Any]: ...

    def path(self, configuration: Configuration, axis: str) -> FeedbackPath:
        """What the sensors and the output of `axis` take; in the rows every sample stands at its own time."""


def parked(configuration: Configuration, count: int) -> NDArray[np.float64]:
    """Samples (count, MAX_AXES) that leave every output at its park voltage, V."""
    samples = np.zeros((count, MAX_AXES))
    samples[:, : len(configuration.axes)] = [configuration.outputs[f"voltage_{n}"].park_V for n in configuration.axes]
    return samples


def resting(configuration: Configuration, axis: str, count: int) -> NDArray[np.float64]:
    """Samples (count, MAX_AXES) that hold `axis` at its working point (um), and the others parked (V)."""
    samples = parked(configuration, count)
    samples[:, list(configuration.axes).index(axis)] = configuration.axes[axis].centre_um
    return samples


def alone(configuration: Configuration, axis: str, mode: str) -> Configuration:
    """The same configuration with `axis` in `mode`, and the others in open loop: nothing else is closed.

    In mode strain the loop is as it is below the outer one: nothing is undone.
    """
    return with_axis(with_axes(configuration, mode="voltage"), axis, mode=mode, actuator=None)


EXCITED = File(source="file", path="(excitation)")
"""The reference of an experiment that plays samples."""


def open_loop(configuration: Configuration) -> Configuration:
    """The same configuration in open loop, playing samples (V)."""
    return with_reference(with_axes(configuration, mode="voltage"), EXCITED)


def play(configuration: Configuration, experiment: Experiment, samples: NDArray[np.float64]) -> NDArray[Any]:
    """Rows (n, axes) of every axis while `samples` (n, MAX_AXES) are played."""
    excited = with_reference(configuration, EXCITED)
    rows: NDArray[Any] = experiment(excited, len(samples) / configuration.loop.rate_hz, samples)["axis"]
    return rows


def within_slew(
    configuration: Configuration, axis: str, wave: NDArray[np.float64], share: float
) -> NDArray[np.float64]:
    """`wave` (n,), um, made smaller where it would go faster than that `share` of the set-point's slew limit."""
    fastest_um_per_s = float(np.abs(np.diff(wave)).max()) * configuration.loop.rate_hz
    allowed = share * 1e3 * configuration.axes[axis].setpoint.slew_um_per_ms
    return np.asarray(min(1.0, allowed / fastest_um_per_s) * wave)


def require_answer(axis: str, sensor: str, moved_um: NDArray[np.float64]) -> None:
    """CheckFailed unless `sensor` of `axis` has seen its actuator move all the time (n,)."""
    if not np.isfinite(moved_um).all():
        raise CheckFailed(
            f"axis {axis}: the {sensor} has gaps in its record; look at its cable, its range and its status"
        )
    if float(np.ptp(moved_um)) == 0.0:
        raise CheckFailed(f"axis {axis}: the {sensor} stands still while the actuator moves; is it connected?")


def with_reference(configuration: Configuration, reference: Reference) -> Configuration:
    """The same configuration with another reference."""
    return configuration.model_copy(update={"reference": reference})


def with_axes(configuration: Configuration, **updates: Any) -> Configuration:
    """The same configuration with fields of *every* axis replaced."""
    axes = {name: axis.model_copy(update=updates) for name, axis in configuration.axes.items()}
    return configuration.model_copy(update={"axes": axes})


def with_axis(configuration: Configuration, name: str, **updates: Any) -> Configuration:
    """The same configuration with fields of one axis replaced."""
    axes: dict[str, Axis] = dict(configuration.axes)
    axes[name] = axes[name].model_copy(update=updates)
    return configuration.model_copy(update={"axes": axes})
