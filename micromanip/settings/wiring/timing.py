"""How often a signal is fresh, or an output taken, and how long either is on its way: what its driver declares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from micromanip.bus.driver import Channel
from micromanip.settings.schema.model import Configuration, Output, Signal

from ..text.place import Path
from ..text.source import Source
from .places import Wiring


@dataclass(frozen=True)
class FeedbackPath:
    """What an axis' sensors and its output take, in cycles of the loop; the defaults: all in every cycle, at once."""

    strain_cycles: int = 1
    """From one sample of the gauge to the next."""
    strain_late: int = 0
    """From being measured to being seen by the loop."""
    stage_cycles: int = 1
    stage_late: int = 0
    output_late: int = 0
    """From a set-point to its voltage on the average, see `output_cycles`."""


AT_ONCE = FeedbackPath()

_TOLD = 0.2
"""Share of the sampling rate."""
_LOST = 2
"""Samples in a row that a signal may lose where the file says nothing of its age."""


def path_bandwidth(path: FeedbackPath, rate_hz: float) -> float:
    """Up to which frequency (Hz) a line through the samples, and voltages held between writes, tell the truth."""
    slowest = max(path.strain_cycles, path.stage_cycles, 2 * path.output_late)
    return _TOLD * rate_hz / slowest if path != AT_ONCE else math.inf


def signal_timing(configuration: Configuration, wiring: Wiring, name: str) -> Channel:
    """Rate and latency of a signal of the configuration, under its name there."""
    entry = configuration.signals[name]
    return _timing(configuration, name, entry, wiring.drivers[entry.driver].slow_inputs)


def with_ages(configuration: Configuration, wiring: Wiring) -> Configuration:
    """Each signal of whose ``max_age_us`` the file says nothing: on its way, and until the next after `_LOST`."""
    signals = dict(configuration.signals)
    for name, entry in configuration.signals.items():
        if "max_age_us" not in entry.model_fields_set and entry.driver in wiring.drivers:
            timing = signal_timing(configuration, wiring, name)
            oldest_us = round(1e6 * (timing.latency_s + (1 + _LOST) / timing.rate_hz), 1)
            signals[name] = entry.model_copy(update={"max_age_us": oldest_us})
    return configuration.model_copy(update={"signals": signals})


def age_is_computed(source: Source, path: Path) -> bool:
    """Whether the key at `path` is a signal's ``max_age_us`` of which the file says nothing."""
    if path[0] != "signals" or path[-1] != "max_age_us":
        return False
    return "max_age_us" not in source.data.get("signals", {}).get(path[1], {})


def sensor_timing(configuration: Configuration, wiring: Wiring, role: str, axis: str) -> Channel:
    """Rate and latency of an axis' sensor; those of the loop where the axis does without it."""
    name = f"{role}_{axis}"
    if name not in configuration.signals:
        return Channel(name, float(configuration.loop.rate_hz))
    return signal_timing(configuration, wiring, name)


def output_timing(configuration: Configuration, wiring: Wiring, name: str) -> Channel:
    """Rate and latency of an output of the configuration, under its name there."""
    entry = configuration.outputs[name]
    return _timing(configuration, name, entry, wiring.drivers[entry.driver].slow_outputs)


def cycles_between(configuration: Configuration, channel: Channel) -> int:
    """Cycles of the loop from one sample to the next; 1 for what is fresh in every cycle."""
    return max(1, round(configuration.loop.rate_hz / channel.rate_hz))


def output_cycles(configuration: Configuration, channel: Channel) -> int:
    """Cycles from a set-point to its voltage, on the average: the way, and half of the time for which it is held.

    0 for an output that is written in every cycle: what such a one takes belongs to the plant.
    """
    if channel.rate_hz >= configuration.loop.rate_hz and channel.latency_s == 0.0:
        return 0
    return round((channel.latency_s + 0.5 / channel.rate_hz) * configuration.loop.rate_hz)


def feedback_path(configuration: Configuration, wiring: Wiring, axis: str) -> FeedbackPath:
    """The path of one axis."""
    strain, stage = (sensor_timing(configuration, wiring, role, axis) for role in ("strain", "stage"))
    rate_hz, voltage = configuration.loop.rate_hz, output_timing(configuration, wiring, f"voltage_{axis}")
    return FeedbackPath(
        cycles_between(configuration, strain),
        math.ceil(strain.latency_s * rate_hz - 1e-6),
        cycles_between(configuration, stage),
        math.ceil(stage.latency_s * rate_hz - 1e-6),
        output_cycles(configuration, voltage),
    )


def _timing(configuration: Configuration, name: str, entry: Signal | Output, slow: Sequence[Channel]) -> Channel:
    wanted = entry.channel or name
    found = next((channel for channel in slow if channel.name == wanted), None)
    rate_hz = float(configuration.loop.rate_hz)
    return Channel(name, rate_hz) if found is None else replace(found, name=name, rate_hz=min(found.rate_hz, rate_hz))
