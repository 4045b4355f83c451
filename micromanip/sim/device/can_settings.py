"""The device's side of a `canbus` driver, read plainly from the configuration.

Whoever runs the driver has its options validated by the driver itself; a device only needs to know what to send and
how fast, and says clearly what it can't read.
"""

from __future__ import annotations

import difflib
import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import cantools

from micromanip.settings.source import Source

from .dbc_message import DbcMessage

logging.getLogger("cantools").addHandler(logging.NullHandler())  # what matters of its warnings is raised here


@dataclass(frozen=True)
class CanSettings:
    """One bus: what its device sends, with rates, and what it receives."""

    interface: str
    channel: str
    bitrate: int
    data_bitrate: int | None
    sends: list[tuple[DbcMessage, float]]
    receives: list[DbcMessage]


def read_can_settings(name: str, options: Mapping[str, Any], source: Source) -> CanSettings:
    """Settings of the driver called `name`; raises ConfigError with file, line and key."""
    place = ("drivers", name)
    data_bitrate = _value(source, place, options, "data_bitrate", int) if options.get("data_bitrate") else None
    database = _database(source, place, _value(source, place, options, "database", str))
    messages: dict[str, list[tuple[DbcMessage, float]]] = {"receive": [], "send": []}
    for direction, found in messages.items():
        for key, entry in (options.get(direction) or {}).items():
            where = (*place, direction, key)
            message = _message(source, where, database, key)
            if message.is_fd and data_bitrate is None:
                raise source.error(where, f"{key} is a CAN FD message; give the bus a data_bitrate")
            counter = entry.get("counter") if isinstance(entry, Mapping) else None
            if counter is not None and counter not in [signal.name for signal in message.signals]:
                raise source.error(where, f"{key} has no signal {counter} to count with")
            rate_hz = float(_value(source, where, entry, "rate_hz", (int, float)))
            if not rate_hz > 0:
                raise source.error((*where, "rate_hz"), f"must be greater than 0, not {rate_hz:g}")
            found.append((DbcMessage(message, counter=counter, bitrate_switch=_switches(message)), rate_hz))
    return CanSettings(
        interface=_value(source, place, options, "interface", str),
        channel=str(_value(source, place, options, "channel", (str, int))),
        bitrate=_value(source, place, options, "bitrate", int),
        data_bitrate=data_bitrate,
        sends=messages["receive"],  # the names are the controller's
        receives=[message for message, _ in messages["send"]],
    )


def _value(source: Source, place: tuple[str, ...], section: Any, key: str, kind: Any) -> Any:
    if not isinstance(section, Mapping) or key not in section:
        raise source.error(place, f"{key} is missing, which the device needs to know")
    if not isinstance(section[key], kind) or isinstance(section[key], bool):
        raise source.error((*place, key), f"{section[key]!r} is no {key}")
    return section[key]


def _database(source: Source, place: tuple[str, ...], file: str) -> Any:
    path = source.path.parent / file
    try:
        return cantools.database.load_file(path, database_format="dbc")
    except OSError as error:
        raise source.error((*place, "database"), f"{path} can't be read: {error.strerror}") from error
    except (cantools.Error, ValueError) as error:
        raise source.error((*place, "database"), f"{path} is not a usable DBC file: {error}") from error


def _message(source: Source, where: tuple[str, ...], database: Any, name: str) -> Any:
    found = {message.name: message for message in database.messages}
    if name not in found:
        raise source.error(where, f"the DBC file has no message {name}; {_near(name, found)}")
    if found[name].is_multiplexed():
        raise source.error(where, f"{name} is multiplexed, which the device does not play")
    return found[name]


def _switches(message: Any) -> bool:
    attribute = message.dbc.attributes.get("CANFD_BRS") if message.dbc else None
    return attribute is None or bool(int(attribute.value))


def _near(name: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(name, list(known), 1)
    return f"did you mean {near[0]}?" if near else f"it has {', '.join(known)}"
