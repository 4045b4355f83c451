"""The devices of a driver `modbus`: units on a serial line, or behind one TCP address."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from micromanip.emulation.emulated import EmulatedDevice, Surroundings
from micromanip.emulation.line.device import Behind
from micromanip.emulation.line.device_line import DeviceLine, port_maker
from micromanip.emulation.line.faults import Identity
from micromanip.emulation.line.port import Peer
from micromanip.emulation.messages import MessageFigures
from micromanip.testbus.event_loop import EventLoop

from . import faults as modbus_faults
from .faults import ModbusException
from .frames import Frames, Request, RtuFrames, TcpFrames
from .server import answer, refused
from .unit import ModbusUnit, unit_of

_GATEWAY_TARGET = 11
_EVERY_NS = 1_000_000
_SILENCE_NS = 5_000_000
"""On a pseudo terminal the silence between frames is no longer exact; a begun frame is given up after this."""


class EmulatedModbus:
    """All units of one line; what they share is the port, and its faults."""

    def __init__(
        self, loop: EventLoop, line: DeviceLine, units: Mapping[int, ModbusUnit], behind: Behind, serial: bool
    ) -> None:
        self.line, self.units, self.figures = line, units, MessageFigures()
        self.signals: list[str] = []
        """What its registers are filled with; set by who knows their names."""
        self._loop, self._behind, self._serial = loop, behind, serial
        self._frames: dict[int, Frames] = {}
        self._off_until_ns = self._began_ns = 0
        line.attach(self._hear)

    @property
    def ready(self) -> str:
        count = sum(unit.registers for unit in self.units.values())
        numbers = ", ".join(f"{unit.name} {number}" for number, unit in self.units.items())
        return f"{self.line.port.name}: Modbus {'RTU' if self._serial else 'TCP'}, units {numbers}, {count} registers"

    @property
    def messages(self) -> list[str]:
        """A unit's answers are its only messages."""
        return [unit.name for unit in self.units.values()]

    def start(self, now_ns: int) -> None:
        self._began_ns = now_ns
        self._go_on()

    def stop_counter(self, message: str, for_s: float | None) -> None:
        self._unit(message).counts_from_ns = self._loop.end_ns(for_s)

    def silence(self, message: str, for_s: float | None) -> None:
        self._unit(message).silent_until_ns = self._loop.end_ns(for_s)

    def reboot(self, for_s: float) -> None:
        now_ns = self._loop.now_ns()
        self._off_until_ns = now_ns + round(for_s * 1e9)
        self._behind.trip(now_ns)

    def inject(self, fault: Mapping[str, Any]) -> None:
        self.line.inject(modbus_faults.parsed(fault, serial=self._serial))

    def clear(self) -> None:
        self.line.clear()
        for unit in self.units.values():
            unit.silent_until_ns = unit.counts_from_ns = 0

    def report(self) -> dict[str, Any]:
        elapsed_ns = max(1, self._loop.now_ns() - self._began_ns)
        figures = self.line.port.figures
        return {
            **vars(self.figures),
            "frames": self.figures.received + self.figures.sent,
            "bus_load_percent": round(100 * figures.busy_ns / elapsed_ns, 2),
        }

    def close(self) -> None:
        self.line.port.close()

    def _go_on(self) -> None:
        """The plant moves, and the watchdog of the amplifier waits, also while nobody asks."""
        now_ns = self._loop.now_ns()
        self._behind.advance_to(now_ns)
        self._loop.call_at(now_ns + _EVERY_NS, self._go_on)

    def _hear(self, data: bytes, peer: Peer) -> None:
        now_ns = self._loop.now_ns()
        if not data:
            self._frames.pop(id(peer), None)
            return
        if now_ns < self._off_until_ns:
            self.figures.silent += 1
            return
        frames = self._frames.get(id(peer))
        if frames is None:
            frames = self._frames[id(peer)] = RtuFrames(_SILENCE_NS) if self._serial else TcpFrames()
        for request in frames.taken(data, now_ns):
            self._answer(request, peer, now_ns)

    def _answer(self, request: Request, peer: Peer, now_ns: int) -> None:
        self.figures.received += 1
        unit = self.units.get(request.unit)
        if unit is None and not self._serial:
            self._send(peer, request.seal(refused(request.pdu, _GATEWAY_TARGET)))
        if unit is None:
            return
        if now_ns < unit.silent_until_ns:
            self.figures.silent += 1
            return
        exception = self.line.active(ModbusException)
        if exception is not None and exception.strikes():
            self._send(peer, request.seal(refused(request.pdu, exception.code)))
            return
        unit.is_another = self.line.active(Identity) is not None
        self._send(peer, request.seal(answer(unit, request.pdu, now_ns)))

    def _send(self, peer: Peer, frame: bytes) -> None:
        self.figures.sent += 1
        self.line.answer(peer, frame)

    def _unit(self, name: str) -> ModbusUnit:
        return next(unit for unit in self.units.values() if unit.name == name)


def emulate_modbus(name: str, surroundings: Surroundings) -> EmulatedDevice:
    """Port and units of the driver called `name`."""
    keys, cell, loop = surroundings.options(name), surroundings.cell, surroundings.loop
    wires = surroundings.wires(name)
    amplifier = surroundings.amplifier(wires, _slowest_write_ms(keys) if wires.outputs else 0.0)
    behind = Behind(cell, wires, amplifier)
    units = {unit.unit_id: unit_of(unit_name, unit, behind) for unit_name, unit in keys.units.items()}
    line = DeviceLine(loop, port_maker(keys, loop, half_duplex=True))
    device = EmulatedModbus(loop, line, units, behind, keys.serial is not None)
    device.signals = list(wires.signals.values())
    return device


def _slowest_write_ms(keys: Any) -> float:
    """Longest period of a task that writes; 0 without one."""
    tasks = [task for unit in keys.units.values() for task in unit.tasks.values() if task.write]
    return max((1e3 / task.rate_hz for task in tasks), default=0.0)
