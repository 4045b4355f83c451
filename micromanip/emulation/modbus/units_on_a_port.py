"""The devices of a driver `modbus`: units on a serial line, or behind one TCP address; and their own faults.

exception    requests are answered with exception ``code``: {"inject": "exception", "code": 6, "share": 0.1}
transaction  answers carry the number of another request; Modbus TCP only
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from micromanip.emulation.emulated import EmulatedDevice, Surroundings
from micromanip.emulation.line import faults as line_faults
from micromanip.emulation.line.device import Behind, LineDevice
from micromanip.emulation.line.device_line import DeviceLine, port_maker
from micromanip.emulation.line.faults import LineFault, MessageFault, Parts
from micromanip.emulation.line.port import Peer
from micromanip.errors import UsageError
from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.fault import validated

from .server import Frames, Request, RtuFrames, TcpFrames, answer, refused
from .unit import ModbusUnit, unit_of

_NUMBER_BYTES = 2


class ModbusException(MessageFault):
    """Requests are refused; nothing is done."""

    kind: Literal["exception"]
    code: Annotated[int, Field(ge=1, le=255)] = 4


class WrongTransaction(MessageFault):
    """Answers carry the number of the request after the one that they answer."""

    kind: Literal["transaction"]

    def through(self, message: bytes) -> Parts:
        number = int.from_bytes(message[:_NUMBER_BYTES], "big") + 1
        return [(0, (number % 0x10000).to_bytes(_NUMBER_BYTES, "big") + message[_NUMBER_BYTES:])]


_OWN: TypeAdapter[MessageFault] = TypeAdapter(
    Annotated[ModbusException | WrongTransaction, Field(discriminator="kind")]
)


def parsed(document: Mapping[str, Any], *, serial: bool) -> LineFault:
    """The fault that a mapping describes. Raises UsageError with the first thing that is wrong with it."""
    kind = document.get("kind")
    if kind not in ("exception", "transaction"):
        return line_faults.parsed(document)
    if kind == "transaction" and serial:
        raise UsageError("fault transaction: on a serial line answers have no number")
    return validated(_OWN, document)


_GATEWAY_TARGET = 11
_SILENCE_NS = 5_000_000
"""On a pseudo terminal the silence between frames is no longer exact; a begun frame is given up after this."""


class EmulatedModbus(LineDevice):
    """All units of one line; what they share is the port, and its faults."""

    faults = ("identity",)

    def __init__(
        self, loop: EventLoop, line: DeviceLine, units: Mapping[int, ModbusUnit], behind: Behind, serial: bool
    ) -> None:
        super().__init__(loop, line, behind)
        self._units, self._serial = units, serial
        self._frames: dict[int, Frames] = {}

    @property
    def description(self) -> str:
        count = sum(unit.registers for unit in self._units.values())
        numbers = ", ".join(f"{unit.name} {number}" for number, unit in self._units.items())
        return f"Modbus {'RTU' if self._serial else 'TCP'}, units {numbers}, {count} registers"

    @property
    def messages(self) -> list[str]:
        """A unit's answers are its only messages."""
        return [unit.name for unit in self._units.values()]

    def stop_counter(self, message: str, for_s: float | None) -> None:
        self._unit(message).counts_from_ns = self._loop.end_ns(for_s)

    def silence(self, message: str, for_s: float | None) -> None:
        self._unit(message).silent_until_ns = self._loop.end_ns(for_s)

    def inject(self, fault: Mapping[str, Any]) -> None:
        self._line.inject(parsed(fault, serial=self._serial))

    def clear(self) -> None:
        super().clear()
        for unit in self._units.values():
            unit.silent_until_ns = unit.counts_from_ns = 0

    def hear(self, data: bytes, peer: Peer) -> None:
        if not data:
            self._frames.pop(id(peer), None)
            return
        frames = self._frames.get(id(peer))
        if frames is None:
            frames = self._frames[id(peer)] = RtuFrames(_SILENCE_NS) if self._serial else TcpFrames()
        now_ns = self._loop.now_ns()
        for request in frames.taken(data, now_ns):
            self._answer(request, peer, now_ns)

    def _answer(self, request: Request, peer: Peer, now_ns: int) -> None:
        self.figures.received += 1
        unit = self._units.get(request.unit)
        if unit is None and not self._serial:
            self._send(peer, request.seal(refused(request.pdu, _GATEWAY_TARGET)))
        if unit is None:
            return
        if now_ns < unit.silent_until_ns:
            self.figures.silent += 1
            return
        exception = self._line.active("exception")
        if exception is not None and exception.strikes():
            self._send(peer, request.seal(refused(request.pdu, exception.code)))
            return
        unit.is_another = self._line.active("identity") is not None
        self._send(peer, request.seal(answer(unit, request.pdu, now_ns)))

    def _send(self, peer: Peer, frame: bytes) -> None:
        self.figures.sent += 1
        self._line.answer(peer, frame)

    def _unit(self, name: str) -> ModbusUnit:
        return next(unit for unit in self._units.values() if unit.name == name)


def emulate_modbus(name: str, surroundings: Surroundings) -> EmulatedDevice:
    """Port and units of the driver called `name`."""
    keys, cell, loop = surroundings.options(name), surroundings.cell, surroundings.loop
    wires = surroundings.wires(name)
    tasks = (task for unit in keys.units.values() for task in unit.tasks.values())
    amplifier = surroundings.amplifier(wires, (task.rate_hz for task in tasks if task.write))
    behind = Behind(cell, wires, amplifier)
    units = {unit.unit_id: unit_of(unit_name, unit, behind) for unit_name, unit in keys.units.items()}
    line = DeviceLine(loop, port_maker(keys, loop, half_duplex=True))
    device = EmulatedModbus(loop, line, units, behind, keys.serial is not None)
    device.signals = list(wires.signals.values())
    return device
