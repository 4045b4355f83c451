"""The device's side of the framing `ascii`: which device its preset speaks of, and what its channels are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from micromanip.emulation.plain_options import Place, section
from micromanip.settings.text.source import Source

from .ascii_device import Interpreter
from .command_value_amplifier import CommandValueAmplifier
from .device import Behind
from .device_line import DeviceLine
from .gcs_axis import Affine, GcsAxis
from .gcs_controller import GcsController

_VOLTS = (-30.0, 135.0)
"""What a channel can do whose range the configuration doesn't tell."""
_POSITIONS = ("POS?", "TSP?")


def read_interpreter(
    source: Source, place: Place, options: Mapping[str, Any], behind: Behind, line: DeviceLine
) -> Interpreter:
    """The device of the preset in the section `ascii` at `place`; raises ConfigError where there is none."""
    match options.get("preset"):
        case "gcs":
            return _gcs(source, place, options, behind, line)
        case "command,value":
            return _command_value(source, place, options, behind, line)
    raise source.error((*place, "preset"), "devices are played for the presets gcs and command,value")


def _gcs(source: Source, place: Place, options: Mapping[str, Any], behind: Behind, line: DeviceLine) -> GcsController:
    outputs: dict[str, Affine] = {}
    sensors: dict[str, dict[str, Affine]] = {}
    limits: dict[str, tuple[float, float]] = {}
    for command, item, channel, entry in _fields(source, place, options, "write"):
        limits.setdefault(item, _VOLTS)
        if command == "SVA":
            outputs[item], limits[item] = _affine(channel, entry), _limits(channel, entry)
    for command, item, channel, entry in _fields(source, place, options, "read"):
        limits.setdefault(item, _VOLTS)
        if command in _POSITIONS:
            sensors.setdefault(item, {})[command] = _affine(channel, entry)
    axes = [GcsAxis(name, behind, outputs.get(name), limits[name], sensors.get(name, {})) for name in sorted(limits)]
    return GcsController(axes, behind, line)


def _command_value(
    source: Source, place: Place, options: Mapping[str, Any], behind: Behind, line: DeviceLine
) -> CommandValueAmplifier:
    writes = {
        (command, item): (_affine(channel, entry), _limits(channel, entry))
        for command, item, channel, entry in _fields(source, place, options, "write")
    }
    reads = {
        (command, item): _affine(channel, entry)
        for command, item, channel, entry in _fields(source, place, options, "read")
    }
    identity = options.get("identity")
    request = identity.get("request") if isinstance(identity, Mapping) else None
    return CommandValueAmplifier(writes, reads, request or "ver", behind, line)


def _fields(
    source: Source, place: Place, options: Mapping[str, Any], key: str
) -> Iterator[tuple[str, str, str, Mapping[str, Any]]]:
    """Command, item on the device, channel and section of each field."""
    for name, exchange in section(source, place, options, key).items():
        for channel, entry in section(source, (*place, key, name), exchange, "fields").items():
            entry = entry or {}
            yield str(exchange.get("command") or ""), str(entry.get("item") or channel), channel, entry


def _affine(channel: str, entry: Mapping[str, Any]) -> Affine:
    return Affine(channel, float(entry.get("scale", 1.0)), float(entry.get("offset", 0.0)))


def _limits(channel: str, entry: Mapping[str, Any]) -> tuple[float, float]:
    """Lowest and highest number on the line."""
    low, high = sorted(_affine(channel, entry).number(float(end)) for end in entry.get("range") or _VOLTS)
    return low, high
