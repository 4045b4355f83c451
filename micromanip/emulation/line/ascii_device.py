"""A device that takes lines of text and answers them, one after the other, as the preset that it speaks says."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

from micromanip.testbus.event_loop import EventLoop

from .command_value_amplifier import CommandValueAmplifier
from .device import Behind, LineDevice
from .device_line import DeviceLine
from .fault import LineFault
from .gcs_axis import Affine, GcsAxis
from .gcs_controller import GcsController
from .port import Peer

_LONGEST = 1024
"""A line that is longer is no line of anybody who knows the protocol."""
_VOLTS = (-30.0, 135.0)
"""What a channel can do whose range the configuration doesn't tell."""
_POSITIONS = ("POS?", "TSP?")


class Interpreter(Protocol):
    """What knows the commands."""

    description: str
    faults: tuple[type[LineFault], ...]
    single_bytes: bytes
    """Commands of one byte, that no line end follows."""
    signals: list[str]

    def step(self) -> None:
        """What it does by itself, a thousand times a second."""

    def answer(self, line: str) -> str:
        """What comes back for a line, with its line ends; empty for nothing."""

    def reboot(self) -> None:
        """Forget what was set."""


class AsciiDevice(LineDevice):
    """Lines end in CR, LF or both."""

    def __init__(
        self, loop: EventLoop, line: DeviceLine, behind: Behind, interpreter: Interpreter, turnaround_ns: int
    ) -> None:
        """An answer begins `turnaround_ns` after the end of its line."""
        super().__init__(loop, line, behind)
        self.faults, self.signals = interpreter.faults, interpreter.signals
        self._interpreter, self._turnaround_ns = interpreter, turnaround_ns
        self._begun: dict[Peer, bytes] = {}

    @property
    def description(self) -> str:
        return self._interpreter.description

    def hear(self, data: bytes, peer: Peer) -> None:
        if not data:
            self._begun.pop(peer, None)
            return
        rest = self._begun.get(peer, b"")
        for i in range(len(data)):
            byte = data[i : i + 1]
            if byte in b"\r\n":
                if rest.strip():
                    self._answer(peer, rest)
                rest = b""
            elif byte in self._interpreter.single_bytes:
                self._answer(peer, byte)
            else:
                rest = (rest + byte)[-_LONGEST:]
        self._begun[peer] = rest

    def tick(self) -> None:
        self._interpreter.step()

    def reboot(self, for_s: float) -> None:
        super().reboot(for_s)
        self._interpreter.reboot()
        self._begun.clear()

    def _answer(self, peer: Peer, line: bytes) -> None:
        self.figures.received += 1
        self._behind.advance_to(self._loop.now_ns())
        answer = self._interpreter.answer(line.decode("latin-1")).encode("latin-1")
        if answer:
            self.figures.sent += 1
            ready_ns = self._loop.now_ns() + self._turnaround_ns
            self._loop.call_at(ready_ns, lambda: self._line.answer(peer, answer))


def gcs_controller(keys: Any, behind: Behind, line: DeviceLine) -> GcsController:
    """What the section `ascii` of the driver's options describes, with the preset `gcs`."""
    outputs: dict[str, Affine] = {}
    sensors: dict[str, dict[str, Affine]] = {}
    limits: dict[str, tuple[float, float]] = {}
    for command, item, affine, field in _fields(keys.write):
        limits.setdefault(item, _VOLTS)
        if command == "SVA":
            outputs[item], limits[item] = affine, _limits(affine, field)
    for command, item, affine, _ in _fields(keys.read):
        limits.setdefault(item, _VOLTS)
        if command in _POSITIONS:
            sensors.setdefault(item, {})[command] = affine
    axes = [GcsAxis(name, behind, outputs.get(name), limits[name], sensors.get(name, {})) for name in sorted(limits)]
    return GcsController(axes, behind, line)


def command_value_amplifier(keys: Any, behind: Behind, line: DeviceLine) -> CommandValueAmplifier:
    """The same with the preset `command,value`."""
    writes = {(command, item): (affine, _limits(affine, field)) for command, item, affine, field in _fields(keys.write)}
    reads = {(command, item): affine for command, item, affine, _ in _fields(keys.read)}
    request = keys.identity.request if keys.identity else None
    return CommandValueAmplifier(writes, reads, request or "ver", behind, line)


PRESETS: dict[str, Callable[[Any, Behind, DeviceLine], Interpreter]] = {
    "gcs": gcs_controller,
    "command,value": command_value_amplifier,
}


def _fields(exchanges: Mapping[str, Any]) -> Iterator[tuple[str, str, Affine, Any]]:
    """Command, item on the device, channel and keys of each field."""
    for exchange in exchanges.values():
        for channel, field in exchange.fields.items():
            yield exchange.command or "", field.item or channel, Affine(channel, field.scale, field.offset), field


def _limits(affine: Affine, field: Any) -> tuple[float, float]:
    """Lowest and highest number on the line."""
    given = field.range if "range" in field.model_fields_set else _VOLTS
    low, high = sorted(affine.number(end) for end in given)
    return low, high
