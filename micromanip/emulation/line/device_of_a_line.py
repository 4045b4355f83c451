"""The device of a driver `line`, as its port and its framing say: a board, a controller, an amplifier, a sensor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from micromanip.emulation.emulated import PlayedDevice, Surroundings
from micromanip.emulation.messages import Due
from micromanip.emulation.plain_options import Place, section, value
from micromanip.emulation.wires import wires_of
from micromanip.errors import UsageError
from micromanip.settings.text.source import Source
from micromanip.testbus.event_loop import EventLoop

from .ascii_device import AsciiDevice
from .ascii_settings import read_interpreter
from .binary_board import BinaryBoard
from .binary_settings import hexadecimal, period_ns, read_board
from .device import Behind, LineDevice
from .device_line import DeviceLine
from .faults import GcsError, Identity, parsed
from .port import Hear, LinePort
from .pseudo_terminal import PseudoTerminal
from .stream_device import StreamDevice
from .stream_settings import read_packet, samples_a_packet
from .tcp_port import TcpPort
from .udp_port import UdpPort


class PlayedLine:
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


def play_line(name: str, surroundings: Surroundings) -> PlayedDevice:
    """Line and device of the driver called `name`."""
    source, cell, loop = surroundings.source, surroundings.cell, surroundings.loop
    place, options = ("drivers", name), surroundings.configuration.drivers[name].options
    wires = wires_of(name, surroundings.configuration, source, cell)
    framing = _one_of(source, place, options, ("binary", "ascii", "stream"))
    layout = section(source, place, options, framing)
    period_ms = _slowest_ms(source, place, framing, layout) if wires.outputs else 0.0
    amplifier = surroundings.amplifier(wires, period_ms)
    behind = Behind(cell, wires, amplifier)
    line = DeviceLine(loop, _port_maker(source, place, options, loop))
    try:
        device = _DEVICES[framing](source, (*place, framing), layout, loop, line, behind)
    except BaseException:
        line.close()
        raise
    return PlayedLine(line, device, loop)


def _board(
    source: Source, place: Place, layout: Mapping[str, Any], loop: EventLoop, line: DeviceLine, behind: Behind
) -> LineDevice:
    return BinaryBoard(loop, line, behind, read_board(source, place, layout))


def _ascii(
    source: Source, place: Place, layout: Mapping[str, Any], loop: EventLoop, line: DeviceLine, behind: Behind
) -> LineDevice:
    interpreter = read_interpreter(source, place, layout, behind, line)
    return AsciiDevice(loop, line, behind, interpreter, round(float(layout.get("turnaround_us", 0.0)) * 1e3))


def _stream(
    source: Source, place: Place, layout: Mapping[str, Any], loop: EventLoop, line: DeviceLine, behind: Behind
) -> LineDevice:
    packet, samples = read_packet(source, place, layout), samples_a_packet(source, place, layout)
    begin = hexadecimal(source, place, layout, "start") if layout.get("start") else b""
    return StreamDevice(loop, line, behind, place[1], packet, period_ns(source, place, layout), samples, begin)


_DEVICES: dict[str, Callable[..., LineDevice]] = {"binary": _board, "ascii": _ascii, "stream": _stream}


def _port_maker(
    source: Source, place: Place, options: Mapping[str, Any], loop: EventLoop
) -> Callable[[Hear], LinePort]:
    kind = _one_of(source, place, options, ("serial", "tcp", "udp"))
    where, entry = (*place, kind), section(source, place, options, kind)
    if kind == "serial":
        return partial(_serial_port, source, where, entry, loop)
    host, port = value(source, where, entry, "host", str), value(source, where, entry, "port", int)
    bits_per_s = 1e6 * float(entry.get("link_Mbit_per_s", 100.0))
    if kind == "tcp":
        return lambda hear: TcpPort(loop, host, port, hear, bits_per_s)
    return lambda hear: UdpPort(loop, host, port, entry.get("listen"), hear, bits_per_s)


def _serial_port(source: Source, place: Place, entry: Mapping[str, Any], loop: EventLoop, hear: Hear) -> LinePort:
    rs485 = entry.get("rs485")
    bits = 1 + int(entry.get("bytesize", 8)) + (entry.get("parity", "none") != "none") + int(entry.get("stopbits", 1))
    port = PseudoTerminal(
        loop,
        Path(value(source, place, entry, "device", str)),
        value(source, place, entry, "baud", int),
        lambda data: hear(data, port),
        bits_per_byte=bits,
        half_duplex=rs485 is not None,
    )
    port.echo = bool(rs485 and rs485.get("echo"))
    return port


def _slowest_ms(source: Source, place: Place, framing: str, layout: Mapping[str, Any]) -> float:
    """Longest period of what is written."""
    key = {"binary": "send", "ascii": "write"}.get(framing)
    if key is None:
        return 0.0
    where = (*place, framing, key)
    sections = section(source, (*place, framing), layout, key)
    return max((period_ns(source, (*where, name), entry) * 1e-6 for name, entry in sections.items()), default=0.0)


def _one_of(source: Source, place: Place, options: Mapping[str, Any], keys: tuple[str, ...]) -> str:
    given = [key for key in keys if options.get(key) is not None]
    if len(given) != 1:
        raise source.error(place, f"give one of {', '.join(keys)}; there are {' and '.join(given) or 'none'}")
    return given[0]
