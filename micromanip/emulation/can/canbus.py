"""The device of a driver `canbus`, with the bus that it is on: messages of a DBC file, sent at fixed rates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools

from micromanip.emulation.amplifier import Amplifier
from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.emulated import EmulatedDevice, Surroundings, Wires
from micromanip.emulation.messages import Due, Periodic, Sender
from micromanip.files import marked_encoding
from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.frame import Frame

from .can_bus import CanBus


class DbcMessage:
    """Values to frames and back, for one message of cantools."""

    def __init__(self, message: Any, *, counter: str | None) -> None:
        """`counter` is the signal that counts the frames."""
        self.name: str = message.name
        self.identifier: int = message.frame_id
        self.extended: bool = message.is_extended_frame
        self.signals: list[str] = [signal.name for signal in message.signals if signal.name != counter]
        self._layout, self._counter = message, counter
        self._fd = bool(message.is_fd)
        self._bitrate_switch = self._fd and _switches_bitrate(message)
        self._ends = {signal.name: _ends(signal) for signal in message.signals}
        ends = [((1 << signal.length) - 1, signal.maximum) for signal in message.signals if signal.name == counter]
        self._counts = max((1 + min(most, int(maximum or most)) for most, maximum in ends), default=0)

    def frame(self, values: Mapping[str, float], count: int) -> Frame:
        """A frame; a value that its signal can't hold is the nearest one that it can.

        NaN is sent as such where the DBC has a floating-point number, else as the largest code.
        """
        held: dict[str, float] = {}
        for name, value in values.items():
            low, high, floating = self._ends[name]
            if math.isnan(value):
                held[name] = value if floating else high
            else:
                held[name] = min(max(value, low), high)
        if self._counter is not None:
            held[self._counter] = count % self._counts
        data = self._layout.encode(held, strict=False)
        return Frame(self.identifier, data, self.extended, self._fd, self._bitrate_switch)

    def values(self, frame: Frame) -> dict[str, float] | None:
        """Values by signal, without the counter; None for a frame that is too short."""
        if len(frame.data) < self._layout.length:
            return None
        values: dict[str, float] = self._layout.decode(frame.data, decode_choices=False)
        values.pop(self._counter or "", None)
        return values


def _ends(signal: Any) -> tuple[float, float, bool]:
    """Lowest and highest value that the bits of a signal hold, and whether it is a floating-point number."""
    if signal.is_float:
        return -math.inf, math.inf, True
    bits = signal.length
    codes = (-(1 << bits - 1), (1 << bits - 1) - 1) if signal.is_signed else (0, (1 << bits) - 1)
    ends = sorted(code * signal.scale + signal.offset for code in codes)
    return ends[0], ends[1], False


def _switches_bitrate(message: Any) -> bool:
    """Whether the data of a CAN FD message go at the second rate: as its attribute CANFD_BRS says, or the file's
    default of that, else they do.
    """
    if message.dbc is None:
        return True
    if own := message.dbc.attributes.get("CANFD_BRS"):
        return bool(int(own.value))
    definition = message.dbc.attribute_definitions.get("CANFD_BRS")
    return definition is None or definition.default_value not in ("0", 0)


@dataclass(kw_only=True)
class Sent(Due):
    """A message that the device sends: a node of its own on the bus, where identifiers say what goes first."""

    message: DbcMessage
    signals: dict[str, str]
    """Signal of the DBC to signal of the cell."""

    def on_frame(self, frame: Frame, time_ns: int) -> None:
        """It does not listen."""


class EmulatedCanBus(CanBus, Sender):
    """One node that takes all messages of the driver, and one for each that it sends."""

    def __init__(
        self,
        keys: Any,
        loop: EventLoop,
        cell: EmulatedCell,
        sent: list[Sent],
        received: list[DbcMessage],
        outputs: dict[str, str],
        amplifier: Amplifier | None,
    ) -> None:
        """`outputs` are the plant's outputs by "Message.Signal"; signals that are not among them do nothing."""
        CanBus.__init__(self, keys, loop)
        Sender.__init__(self, loop)
        self.signals = [signal for message in sent for signal in message.signals.values()]
        self._cell, self._outputs, self._amplifier = cell, outputs, amplifier
        self._received = {(message.identifier, message.extended): message for message in received}
        self._off_until_ns = 0
        self.periodic = [Periodic(loop, self.figures, message, cell.advance_to, self._send) for message in sent]
        self.line.attach(self)
        for message in sent:
            self.line.attach(message)

    @property
    def ready(self) -> str:
        return self.described(len(self.periodic), len(self._received))

    def start(self, now_ns: int) -> None:
        CanBus.start(self, now_ns)
        Sender.start(self, now_ns)

    def on_frame(self, frame: Frame, time_ns: int) -> None:
        """Take a command into force at the end of its frame."""
        message = self._received.get((frame.identifier, frame.extended))
        if message is None or frame.remote or frame.error or time_ns < self._off_until_ns:
            return
        values = message.values(frame)
        if values is None:
            self.figures.not_understood += 1
            return
        self.figures.received += 1
        if self._amplifier is not None:
            named = ((self._outputs.get(f"{message.name}.{name}"), value) for name, value in values.items())
            commands = {output: value for output, value in named if output is not None}
            self._amplifier.take(commands, self._loop.now_ns())
            self._cell.advance_to(time_ns)

    def reboot(self, for_s: float) -> None:
        """Be off for a while, with the amplifier; its counters begin anew."""
        now_ns = self._loop.now_ns()
        self._off_until_ns = now_ns + round(for_s * 1e9)
        if self._amplifier is not None:
            self._amplifier.trip(now_ns)
        self.be_off(self._off_until_ns)

    def clear(self) -> None:
        CanBus.clear(self)
        Sender.clear(self)

    def report(self) -> dict[str, Any]:
        return {**vars(self.figures), **super().report()}

    def _send(self, due: Due) -> None:
        assert isinstance(due, Sent)
        read = self._cell.read
        values = {name: read(signal) for name, signal in due.signals.items()}
        if self.line.send(due, due.message.frame(values, due.counted()), due.due_ns):
            self.figures.sent += 1
        else:
            self.figures.not_sent += 1


def emulate_canbus(name: str, surroundings: Surroundings) -> EmulatedDevice:
    """Bus and node of the driver called `name`."""
    keys, cell, loop = surroundings.options(name), surroundings.cell, surroundings.loop
    text = _saved_text(surroundings.source.path.parent / keys.database)
    database: Any = cantools.database.load_string(text, database_format="dbc", strict=False)
    known = {message.name: message for message in database.messages}
    wires = surroundings.wires(name)
    sent = []
    for name_in_dbc, entry in keys.receive.items():
        message = DbcMessage(known[name_in_dbc], counter=entry.counter)
        signals = _filling(name_in_dbc, message.signals, wires, cell)
        sent.append(Sent(name_in_dbc, round(1e9 / entry.rate_hz), message=message, signals=signals))
    received = [DbcMessage(known[name_in_dbc], counter=entry.counter) for name_in_dbc, entry in keys.send.items()]
    return EmulatedCanBus(keys, loop, cell, sent, received, wires.outputs, surroundings.amplifier(wires))


def _saved_text(file: Path) -> str:
    """A file that the driver has taken already, whatever saved it; names are ASCII, the rest does not matter here."""
    content = file.read_bytes()
    return content.decode(marked_encoding(content) or "utf-8", errors="replace").rstrip("\x1a\0")


def _filling(message: str, signals: list[str], wires: Wires, cell: EmulatedCell) -> dict[str, str]:
    """What each signal of a message is filled with: as configured, else by its own name, else with 0."""
    channels = {signal: f"{message}.{signal}" for signal in signals}
    return {
        signal: wires.signals.get(channel, signal if cell.has(signal) else channel)
        for signal, channel in channels.items()
    }
