"""Lines of JSON by which a emulated device is told to fail: ``{"device": "freeze", "signal": "strain_x"}``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from micromanip.errors import ConfigError
from micromanip.quantities import Real, Seconds
from micromanip.settings.load import validate_section
from micromanip.settings.schema.base import Settings
from micromanip.settings.text.source import Source

_KINDS = 'a command is {"device": ...}, {"inject": ...} or {"report": true}'


class Command(Settings):
    """What lasts for `for_s`, or until ``clear``."""

    for_s: Seconds | None = Field(default=None, description="How long; null: until `clear`.")


class Spoilt(Command):
    """The value stands still while the counter goes on; or it is NaN, the largest code where a frame has none."""

    device: Literal["freeze", "nan"]
    signal: str | None = Field(default=None, description="Which one; null: all.")


class Message(Command):
    """The counter stands still while the values go on; or a message does not come."""

    device: Literal["stop_counter", "silence"]
    message: str | None = Field(default=None, description="Which one; null: all.")


class Offset(Command):
    """A step in what a sensor says."""

    device: Literal["offset"]
    signal: str
    value: Real = Field(description="Added to the reading, in its unit.")


class Drift(Command):
    """A ramp in what a sensor says."""

    device: Literal["drift"]
    signal: str
    per_s: Real = Field(description="Added to the reading, in its unit a second.")


class Reboot(Settings):
    """Silent and deaf, then counters from 0 and outputs at rest."""

    device: Literal["reboot"]
    driver: str | None = Field(default=None, description="The device of which driver; null: all.")
    for_s: Seconds = Field(default=0.3, description="How long it takes.")


class Clear(Settings):
    """End everything, injected faults too."""

    device: Literal["clear"]


DeviceCommand = Annotated[Spoilt | Message | Offset | Drift | Reboot | Clear, Field(discriminator="device")]


class _Holder(Settings):
    command: DeviceCommand


def parsed(line: str) -> dict[str, Any]:
    """The mapping that a line holds. Raises ConfigError for what is none, or no command at all."""
    try:
        document = json.loads(line)
    except json.JSONDecodeError as error:
        raise ConfigError(f"not a line of JSON ({error.msg} at column {error.colno}); {_KINDS}") from None
    if not isinstance(document, dict):
        raise ConfigError(f"not a JSON object; {_KINDS}")
    if len({"device", "inject", "report"} & document.keys()) != 1:
        raise ConfigError(_KINDS)
    return document


def device_command(document: dict[str, Any]) -> DeviceCommand:
    """What ``{"device": ...}`` asks for. Raises ConfigError that says what would be right."""
    try:
        source = Source.of({"command": document}, Path())
        return validate_section(source, (), _Holder, {"command": document}).command
    except ConfigError as error:
        raise ConfigError(str(error).replace("command.", "").removeprefix("command: ").replace("\n", "; ")) from None
