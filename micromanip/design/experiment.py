"""How design gets its recordings: a callable that the command hands it, and variants of a configuration."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.records import MAX_AXES
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import File, Reference
from micromanip.settings.wiring.timing import FeedbackPath
from micromanip.settings.wiring.timing import path_bandwidth as path_bandwidth


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
