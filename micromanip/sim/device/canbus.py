"""The device of a driver `canbus`, with the bus that it is on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from micromanip.sim.canbus.faults import parsed
from micromanip.sim.canbus.hub import CanHub

from .amplifier import Amplifier
from .can_device import CanDevice, Sent
from .can_settings import CanSettings, read_can_settings
from .cell import PlayedCell
from .played import PlayedDevice, Surroundings
from .wires import Wires, wires_of

_TEST_BUS = "micromanip"


class PlayedCanBus:
    """A hub and one node on it."""

    def __init__(self, settings: CanSettings, hub: CanHub, device: CanDevice) -> None:
        self._settings, self._hub, self._device = settings, hub, device
        self._began_ns = hub.now_ns()

    @property
    def ready(self) -> str:
        s = self._settings
        rates = [s.bitrate, *([s.data_bitrate] if s.data_bitrate else [])]
        kbits = "/".join(f"{rate / 1e3:g}" for rate in rates)
        return f"{s.channel}: {_messages(len(s.sends))} out, {len(s.receives)} in, {kbits} kbit/s"

    @property
    def signals(self) -> list[str]:
        return [signal for sent in self._device.sent for signal in sent.signals.values()]

    @property
    def messages(self) -> list[str]:
        return [sent.message.name for sent in self._device.sent]

    def start(self, now_ns: int) -> None:
        self._began_ns = now_ns
        self._device.start(now_ns)

    def stop_counter(self, message: str, for_s: float | None) -> None:
        self._sent(message).counts_from_ns = self._end_ns(for_s)

    def silence(self, message: str, for_s: float | None) -> None:
        self._sent(message).silent_until_ns = self._end_ns(for_s)

    def reboot(self, for_s: float) -> None:
        self._device.reboot(for_s)

    def inject(self, fault: Mapping[str, Any]) -> None:
        self._hub.faults.inject(parsed(fault))

    def clear(self) -> None:
        self._hub.faults.clear()
        for sent in self._device.sent:
            sent.silent_until_ns = sent.counts_from_ns = 0

    def report(self) -> dict[str, Any]:
        bus = self._hub.statistics
        elapsed_ns = self._hub.now_ns() - self._began_ns
        return {
            **vars(self._device.figures),
            "frames": bus.frames,
            "destroyed": bus.destroyed,
            "bus_load_percent": round(100 * bus.busy_ns / elapsed_ns, 2) if elapsed_ns > 0 else 0.0,
        }

    def close(self) -> None:
        self._hub.close()

    def _sent(self, message: str) -> Sent:
        return next(sent for sent in self._device.sent if sent.message.name == message)

    def _end_ns(self, for_s: float | None) -> float:
        return float("inf") if for_s is None else self._hub.now_ns() + for_s * 1e9


def play_canbus(name: str, surroundings: Surroundings) -> PlayedDevice:
    """Hub and node of the driver called `name`."""
    source, cell, loop = surroundings.source, surroundings.cell, surroundings.loop
    settings = read_can_settings(name, surroundings.configuration.drivers[name].options, source)
    if settings.interface != _TEST_BUS:
        raise source.error(
            ("drivers", name, "interface"),
            f"devices are played on the interface {_TEST_BUS}, not on {settings.interface}",
        )
    wires = wires_of(name, surroundings.configuration, source, cell)
    amplifier = Amplifier(cell.plant, wires.rest_V, surroundings.watchdog_ms) if wires.outputs else None
    hub = CanHub(loop, settings.channel, settings.bitrate, settings.data_bitrate)
    if amplifier is not None:
        cell.amplifiers.append(amplifier)
    sent = [
        Sent(
            message,
            round(1e9 / rate_hz),
            {name: _source_of(message.name, name, wires, cell) for name in message.signals},
        )
        for message, rate_hz in settings.sends
    ]
    device = CanDevice(loop, hub, cell, sent, settings.receives, wires.outputs, amplifier)
    return PlayedCanBus(settings, hub, device)


def _source_of(message: str, signal: str, wires: Wires, cell: PlayedCell) -> str:
    """What a signal of the DBC is filled with: as configured, else by its own name, else with 0."""
    channel = f"{message}.{signal}"
    return wires.signals.get(channel, signal if cell.has(signal) else channel)


def _messages(count: int) -> str:
    return "1 message" if count == 1 else f"{count} messages"
