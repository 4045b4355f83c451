"""Whether a configuration can be tried on a recording: the same axes, rate, sensors and units, and a stage to hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from micromanip.errors import UsageError
from micromanip.recordings import Telemetry
from micromanip.settings.check import validate
from micromanip.settings.schema.model import Configuration, Output, Signal
from micromanip.settings.schema.reference import Tracker
from micromanip.settings.text.source import Source


def recorded_configuration(telemetry: Telemetry) -> tuple[Source, Configuration]:
    """What was in force when the recording began; CheckFailed where this version can't read it."""
    source = Source.parse(Path(telemetry.file), telemetry.sure_configuration())
    return source, validate(source)


def require_comparable(recorded: Configuration, other: Configuration, file: Path | str, config: Path | str) -> None:
    """Raise UsageError for the first thing in which `other` is another cell than that of the recording."""
    for what, was, is_ in _facts(recorded, other):
        if was != is_:
            raise UsageError(
                f"{config}: {what} is {_shown(is_)}, in {file} it is {_shown(was)}: another tuning is tried on the "
                "same axes, rate, sensors and units"
            )
    for name, axis in other.axes.items():
        if axis.mode != "stage":
            raise UsageError(f"{config}: axes.{name}.mode is {axis.mode}; only tunings with mode: stage are compared")


def _facts(recorded: Configuration, other: Configuration) -> list[tuple[str, Any, Any]]:
    facts: list[tuple[str, Any, Any]] = [
        ("axes", list(recorded.axes), list(other.axes)),
        ("loop.rate_hz", recorded.loop.rate_hz, other.loop.rate_hz),
        ("frame", recorded.frame, other.frame),
        ("reference.source", _follows(recorded), _follows(other)),
    ]
    for name in recorded.axes:
        keys = [f"{role}_{name}" for role in ("strain", "stage", "deviation", "voltage")]
        facts += [(key, _origin(recorded, key), _origin(other, key)) for key in keys]
        if name in other.axes:
            facts.append((f"axes.{name}.centre_um", recorded.axes[name].centre_um, other.axes[name].centre_um))
    used = {entry.driver for entry in recorded.signals.values()} | {entry.driver for entry in recorded.outputs.values()}
    for name in sorted(used):
        was, is_ = (each.drivers[name].model_dump() if name in each.drivers else {} for each in (recorded, other))
        facts += [(f"drivers.{name}.{key}", was.get(key), is_.get(key)) for key in {**was, **is_}]
    return facts


def _follows(configuration: Configuration) -> str:
    return "signal" if isinstance(configuration.reference, Tracker) else "its own"


def _origin(configuration: Configuration, name: str) -> str | None:
    """Driver and channel of a signal or an output."""
    entry: Signal | Output | None = configuration.signals.get(name, configuration.outputs.get(name))
    return None if entry is None else f"{entry.driver}:{entry.channel or name}"


def _shown(value: Any) -> str:
    return "left out" if value is None else f"{value!s:.60}"
