"""The device of a driver `line`, as its port and its framing say: a board, a controller, an amplifier, a sensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from micromanip.emulation.emulated import EmulatedDevice, Surroundings
from micromanip.emulation.messages import Due
from micromanip.errors import UsageError
from micromanip.testbus.event_loop import EventLoop

from .ascii_device import PRESETS, AsciiDevice
from .binary_board import BinaryBoard, board_messages
from .device import Behind, LineDevice
from .device_line import DeviceLine, port_maker
from .faults import GcsError, Identity, parsed
from .stream_device import StreamDevice, packet_layout, samples_per_packet


class EmulatedLine:
    """One device on its line."""

    def __init__(self, line: DeviceLine, device: LineDevice, loop: EventLoop) -> None:
        self.line, self._device, self._loop = line, device, loop
        self._began_ns = loop.now_ns()

    @property
    def ready(self) -> str:
        return f"{self.line.port.name}: {self._device.description}"

    @property
    def signals(self) -> list[str]:
        return self._device.signals

    @property
    def messages(self) -> list[str]:
        return [periodic.message.name for periodic in self._device.periodic]

    def start(self, now_ns: int) -> None:
        self._began_ns = now_ns
        self._device.start(now_ns)

    def stop_counter(self, message: str, for_s: float | None) -> None:
        self._message(message).counts_from_ns = self._loop.end_ns(for_s)

    def silence(self, message: str, for_s: float | None) -> None:
        self._message(message).silent_until_ns = self._loop.end_ns(for_s)

    def reboot(self, for_s: float) -> None:
        self._device.reboot(self._loop.now_ns() + round(for_s * 1e9))

    def inject(self, fault: Mapping[str, Any]) -> None:
        injected = parsed(dict(fault))
        if isinstance(injected, Identity | GcsError) and not isinstance(injected, self._device.faults):
            raise UsageError(f"fault {injected.kind}: {self.ready} has nothing of the kind")
        self.line.inject(injected)

    def clear(self) -> None:
        self.line.clear()
        for periodic in self._device.periodic:
            periodic.message.silent_until_ns = periodic.message.counts_from_ns = 0

    def report(self) -> dict[str, Any]:
        figures, port = self._device.figures, self.line.port.figures
        elapsed_ns = max(1, self._loop.now_ns() - self._began_ns)
        return {
            "frames": figures.sent + figures.received,
            **vars(figures),
            **vars(port),
            "bus_load_percent": round(100 * port.busy_ns / elapsed_ns, 2),
        }

    def close(self) -> None:
        self.line.close()

    def _message(self, name: str) -> Due:
        return next(periodic.message for periodic in self._device.periodic if periodic.message.name == name)


def emulate_line(name: str, surroundings: Surroundings) -> EmulatedDevice:
    """Line and device of the driver called `name`."""
    keys, loop = surroundings.options(name), surroundings.loop
    if keys.ascii is not None and keys.ascii.preset not in PRESETS:
        where = ("drivers", name, "ascii", "preset")
        raise surroundings.source.error(where, f"devices are emulated for the presets {' and '.join(PRESETS)}")
    wires = surroundings.wires(name)
    amplifier = surroundings.amplifier(wires, _slowest_write_ms(keys) if wires.outputs else 0.0)
    behind = Behind(surroundings.cell, wires, amplifier)
    line = DeviceLine(loop, port_maker(keys, loop))
    return EmulatedLine(line, _device(name, keys, loop, line, behind), loop)


def _device(name: str, keys: Any, loop: EventLoop, line: DeviceLine, behind: Behind) -> LineDevice:
    if keys.binary is not None:
        return BinaryBoard(loop, line, behind, board_messages(keys.binary))
    if keys.ascii is not None:
        interpreter = PRESETS[keys.ascii.preset](keys.ascii, behind, line)
        return AsciiDevice(loop, line, behind, interpreter, round(keys.ascii.turnaround_us * 1e3))
    stream = keys.stream
    period_ns, samples = round(1e9 / stream.rate_hz), samples_per_packet(stream)
    begin = bytes.fromhex(stream.start)
    return StreamDevice(loop, line, behind, name, packet_layout(stream), period_ns, samples, begin)


def _slowest_write_ms(keys: Any) -> float:
    """Longest period of what is written."""
    writes = keys.binary.send if keys.binary else keys.ascii.write if keys.ascii else {}
    return max((1e3 / message.rate_hz for message in writes.values()), default=0.0)
