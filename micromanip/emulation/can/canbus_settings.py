"""The device's side of a `canbus` driver: which messages it sends and receives, and how fast."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import cantools

from micromanip.emulation.plain_options import Place, near, section, value
from micromanip.settings.text.source import Source

from .dbc_message import DbcMessage

logging.getLogger("cantools").addHandler(logging.NullHandler())  # what matters of its warnings is raised here


class MessageTable:
    """Messages of the DBC file that the options name; raises ConfigError with file, line and key."""

    def __init__(self, place: Place, options: Mapping[str, Any], source: Source, *, fd: bool) -> None:
        self._place, self._source, self._fd = place, source, fd
        self._database = self._load(source.path.parent / value(source, place, options, "database", str))
        self.sent = [self._rated("receive", name, entry) for name, entry in self._entries(options, "receive")]
        """What the controller receives, with its rate in Hz."""
        self.received = [self._message("send", name, entry) for name, entry in self._entries(options, "send")]

    def _entries(self, options: Mapping[str, Any], direction: str) -> list[tuple[str, Any]]:
        return list(section(self._source, self._place, options, direction).items())

    def _rated(self, direction: str, name: str, entry: Any) -> tuple[DbcMessage, float]:
        where = (*self._place, direction, name)
        rate_hz = float(value(self._source, where, entry, "rate_hz", (int, float)))
        if not rate_hz > 0:
            raise self._source.error((*where, "rate_hz"), f"must be greater than 0, not {rate_hz:g}")
        return self._message(direction, name, entry), rate_hz

    def _message(self, direction: str, name: str, entry: Any) -> DbcMessage:
        where = (*self._place, direction, name)
        known = {message.name: message for message in self._database.messages}
        if name not in known:
            raise self._source.error(where, f"the DBC file has no message {name}; {near(name, known)}")
        message = known[name]
        if message.is_multiplexed():
            raise self._source.error(where, f"{name} is multiplexed, which the device does not play")
        if message.is_fd and not self._fd:
            raise self._source.error(where, f"{name} is a CAN FD message; give the bus a data_bitrate")
        counter = entry.get("counter") if isinstance(entry, Mapping) else None
        signals = [signal.name for signal in message.signals]
        if counter is not None and counter not in signals:
            raise self._source.error((*where, "counter"), f"{name} has no signal {counter}; {near(counter, signals)}")
        return DbcMessage(message, counter=counter, bitrate_switch=_switches_bitrate(message))

    def _load(self, path: Any) -> Any:
        try:
            return cantools.database.load_file(path, database_format="dbc")
        except OSError as error:
            raise self._source.error((*self._place, "database"), f"{path} can't be read: {error.strerror}") from error
        except (cantools.Error, ValueError) as error:
            raise self._source.error((*self._place, "database"), f"{path} is no usable DBC file: {error}") from error


def _switches_bitrate(message: Any) -> bool:
    attribute = message.dbc.attributes.get("CANFD_BRS") if message.dbc else None
    return attribute is None or bool(int(attribute.value))
