"""The device of a driver `canbus`, with the bus that it is on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cantools

from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.emulated import EmulatedDevice, Surroundings, Wires
from micromanip.testbus.event_loop import EventLoop

from .can_bus import CanBus
from .can_device import CanDevice, Sent
from .dbc_message import DbcMessage


class EmulatedCanBus:
    """One node that sends and takes all messages of the driver."""

    def __init__(self, bus: CanBus, device: CanDevice, loop: EventLoop) -> None:
        self.bus, self._device, self._loop = bus, device, loop

    @property
    def ready(self) -> str:
        return self.bus.ready(len(self._device.sent), self._device.understood)

    @property
    def signals(self) -> list[str]:
        return [signal for sent in self._device.sent for signal in sent.signals.values()]

    @property
    def messages(self) -> list[str]:
        return [sent.message.name for sent in self._device.sent]

    def start(self, now_ns: int) -> None:
        self.bus.start(now_ns)
        self._device.start(now_ns)

    def stop_counter(self, message: str, for_s: float | None) -> None:
        self._sent(message).counts_from_ns = self._loop.end_ns(for_s)

    def silence(self, message: str, for_s: float | None) -> None:
        self._sent(message).silent_until_ns = self._loop.end_ns(for_s)

    def reboot(self, for_s: float) -> None:
        self._device.reboot(for_s)

    def inject(self, fault: Mapping[str, Any]) -> None:
        self.bus.inject(fault)

    def clear(self) -> None:
        self.bus.clear()
        for sent in self._device.sent:
            sent.silent_until_ns = sent.counts_from_ns = 0

    def report(self) -> dict[str, Any]:
        return {**vars(self._device.figures), **self.bus.report()}

    def close(self) -> None:
        self.bus.close()

    def _sent(self, message: str) -> Sent:
        return next(sent for sent in self._device.sent if sent.message.name == message)


def emulate_canbus(name: str, surroundings: Surroundings) -> EmulatedDevice:
    """Bus and node of the driver called `name`."""
    keys, cell, loop = surroundings.options(name), surroundings.cell, surroundings.loop
    database: Any = cantools.database.load_file(surroundings.source.path.parent / keys.database, database_format="dbc")
    known = {message.name: message for message in database.messages}
    wires = surroundings.wires(name)
    sent = []
    for name_in_dbc, entry in keys.receive.items():
        message = DbcMessage(known[name_in_dbc], counter=entry.counter)
        signals = _filling(name_in_dbc, message.signals, wires, cell)
        sent.append(Sent(name_in_dbc, round(1e9 / entry.rate_hz), message=message, signals=signals))
    received = [DbcMessage(known[name_in_dbc], counter=entry.counter) for name_in_dbc, entry in keys.send.items()]
    bus = CanBus(keys, loop)
    device = CanDevice(loop, bus.line, cell, sent, received, wires.outputs, surroundings.amplifier(wires))
    return EmulatedCanBus(bus, device, loop)


def _filling(message: str, signals: list[str], wires: Wires, cell: EmulatedCell) -> dict[str, str]:
    """What each signal of a message is filled with: as configured, else by its own name, else with 0."""
    channels = {signal: f"{message}.{signal}" for signal in signals}
    return {
        signal: wires.signals.get(channel, signal if cell.has(signal) else channel)
        for signal, channel in channels.items()
    }
