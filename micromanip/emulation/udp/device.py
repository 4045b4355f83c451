"""A device that answers each datagram with one: it samples when it is asked, and takes the command.

Only the codec is compiled: 10,000 datagrams a second take half of a CPU. Faults are those of a line
(``emulation/line/faults.py``): datagrams lost, doubled, late, corrupt, of strangers; the device silent, or without power.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from micromanip.bus.frame_plan import FramePlan, GroupPlan
from micromanip.emulation.amplifier import Amplifier
from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.emulated import EmulatedDevice, Surroundings, Wires
from micromanip.emulation.line.device_line import DeviceLine
from micromanip.emulation.line.faults import GcsError, Identity, parsed
from micromanip.emulation.line.number import checksum, line_number
from micromanip.emulation.line.port import Peer
from micromanip.emulation.line.udp_port import UdpPort
from micromanip.emulation.messages import MessageFigures
from micromanip.errors import UsageError
from micromanip.rt.jit import prepare
from micromanip.rt.wire.counting import COUNTED, OLD
from micromanip.rt.wire.records import MAX_BYTES, MAX_GROUPS
from micromanip.testbus.event_loop import EventLoop

from .frames import BAD, take_command, write_answer

ANSWER = "receive"
"""What the device sends, by the name that commands use."""
_TICK_NS = 1_000_000
_PAUSE_NS = 100_000_000
_PHASE_NS = 30_000
"""So old is the plant's state when it is asked for: a datagram that comes a little early still finds a new one."""
_OTHER = 1
"""Added to the numbers of an identity by the fault of that name."""


class UdpDevice:
    """The device of one driver `udp`."""

    def __init__(
        self, keys: Any, loop: EventLoop, cell: EmulatedCell, wires: Wires, amplifier: Amplifier | None
    ) -> None:
        """`keys` are the driver's options. Raises DeviceUnavailable for a port that is in use."""
        self._loop, self._cell, self._amplifier, self._keys = loop, cell, amplifier, keys
        self.figures = MessageFigures()
        self._commands, self._answers = _sent(keys).record(), _received(keys).record()
        self._groups = [list(fields) for fields in _groups(keys)]
        names = [channel for group in self._groups for channel in group]
        self.signals = [wires.signals.get(channel, channel) for channel in names]
        self._indices = np.array([cell.plant.inputs.get(signal, 0) for signal in self.signals])
        self._by_amplifiers = [i for i, signal in enumerate(self.signals) if not cell.is_sensor(signal)]
        self._outputs = [wires.outputs.get(channel) for channel in keys.send.fields]
        self._command_values, self._values = np.zeros(len(self._outputs)), np.zeros(len(names))
        self._samples = np.zeros(MAX_GROUPS, np.int64)
        self._data, self._answer = np.zeros(MAX_BYTES, np.uint8), np.zeros(MAX_BYTES, np.uint8)
        self._counted = np.zeros(1, COUNTED)
        self._counted["counts"] = 1 << 8 * keys.send.counter.size
        self._answer_bytes = int(self._answers[0]["length"])
        self._count, self._counts = 0, 1 << 8 * keys.receive.counter.size
        self._unit_ns = keys.receive.clock.unit_us * 1e3 if keys.receive.clock else 1.0
        self._heard_ns = 0
        self._off_until_ns = self._silent_until_ns = self._counts_from_ns = 0.0
        self._began_ns = loop.now_ns()
        prepare(take_command, write_answer)
        bits_per_s = 1e6 * keys.link_Mbit_per_s
        self._line = DeviceLine(
            loop, lambda hear: UdpPort(loop, keys.host, keys.port, keys.listen, hear, bits_per_s)
        )
        self._line.attach(self._hear)

    @property
    def ready(self) -> str:
        return f"{self._line.port.name}: answers each datagram, {len(self.signals)} signals, {len(self._outputs)} outputs"

    @property
    def messages(self) -> list[str]:
        return [ANSWER]

    def start(self, now_ns: int) -> None:
        self._began_ns = now_ns
        self._tick()

    def stop_counter(self, message: str, for_s: float | None) -> None:  # noqa: ARG002 (there is one)
        self._counts_from_ns = self._loop.end_ns(for_s)

    def silence(self, message: str, for_s: float | None) -> None:  # noqa: ARG002
        self._silent_until_ns = self._loop.end_ns(for_s)

    def reboot(self, for_s: float) -> None:
        now_ns = self._loop.now_ns()
        self._off_until_ns, self._count = now_ns + for_s * 1e9, 0
        self._counted["known"] = 0
        if self._amplifier is not None:
            self._amplifier.trip(now_ns)

    def inject(self, fault: Mapping[str, Any]) -> None:
        injected = parsed(dict(fault))
        if isinstance(injected, GcsError):
            raise UsageError(f"fault {injected.kind}: {self.ready} has nothing of the kind")
        self._line.inject(injected)

    def clear(self) -> None:
        self._line.clear()
        self._silent_until_ns = self._counts_from_ns = 0.0

    def report(self) -> dict[str, Any]:
        figures, port = self.figures, self._line.port.figures
        elapsed_ns = max(1, self._loop.now_ns() - self._began_ns)
        return {
            "frames": figures.sent + figures.received,
            **vars(figures),
            **vars(port),
            **{name: int(self._counted[0][name]) for name in ("lost", "doubled", "late", "restarts")},
            "bus_load_percent": round(100 * port.busy_ns / elapsed_ns, 2),
        }

    def close(self) -> None:
        self._line.close()

    def _hear(self, data: bytes, peer: Peer) -> None:
        now_ns = self._loop.now_ns()
        if now_ns < self._off_until_ns:
            return
        length = min(len(data), MAX_BYTES)
        self._data[:length] = np.frombuffer(data, np.uint8, length)
        missing = take_command(self._commands, self._counted, self._data, len(data), self._command_values)
        if missing == BAD:
            self._answer_who(data, peer)
            return
        self.figures.received += 1
        if now_ns - self._heard_ns > _PAUSE_NS:
            self._cell.advance_to(now_ns)
            self._cell.plant.begin(now_ns - _PHASE_NS)
        self._heard_ns = now_ns
        if missing != OLD and self._amplifier is not None:
            values = self._command_values.tolist()
            command = {name: value for name, value in zip(self._outputs, values, strict=True) if name is not None}
            self._amplifier.take(command, now_ns)
        self._cell.advance_to(now_ns)  # up to now with what was in force, from now on with the command
        self._say(now_ns, peer)

    def _say(self, now_ns: int, peer: Peer) -> None:
        if now_ns < self._silent_until_ns:
            self.figures.silent += 1
            return
        cell, plant = self._cell, self._cell.plant
        if cell.faults.any:
            self._values[:] = [cell.read(signal) for signal in self.signals]
        else:  # the same in a third of the time
            self._values[:] = plant.values_at(self._indices)
            for i in self._by_amplifiers:
                self._values[i] = cell.read(self.signals[i])
        for group in range(1, len(self._groups)):
            signal = self.signals[sum(map(len, self._groups[:group]))]
            self._samples[group] = plant.samples(signal) if signal in plant.inputs else 0
        if now_ns >= self._counts_from_ns:
            self._count = (self._count + 1) % self._counts
        stamp = int(plant.time_ns / self._unit_ns)
        write_answer(self._answers, self._count, stamp, self._samples, self._values, self._answer)
        self._line.answer(peer, self._answer[: self._answer_bytes].tobytes())
        self.figures.sent += 1

    def _answer_who(self, data: bytes, peer: Peer) -> None:
        keys = self._keys.identity
        seal = checksum(self._keys.crc)
        if keys is None or not data.startswith(bytes.fromhex(keys.request)):
            self.figures.not_understood += 1
            return
        frame = bytearray(_length(keys, keys.numbers.values(), None))
        frame[: len(bytes.fromhex(keys.head))] = bytes.fromhex(keys.head)
        other = _OTHER if self._line.active(Identity) else 0
        for known in keys.numbers.values():
            line_number(known).put_code(frame, known.value ^ other)
        self._line.answer(peer, bytes(frame) + (seal.of(bytes(frame)) if seal else b""))

    def _tick(self) -> None:
        """Amplifier and plant go on also while nobody asks."""
        now_ns = self._loop.now_ns()
        if now_ns - self._heard_ns > _TICK_NS:
            self._cell.advance_to(now_ns)
        self._loop.call_at(now_ns + _TICK_NS, self._tick)


def emulate_udp(name: str, surroundings: Surroundings) -> EmulatedDevice:
    """The device of the driver called `name`."""
    wires = surroundings.wires(name)
    return UdpDevice(
        surroundings.options(name), surroundings.loop, surroundings.cell, wires, surroundings.amplifier(wires)
    )


def _groups(keys: Any) -> Iterator[Mapping[str, Any]]:
    yield keys.receive.fields
    for slow in keys.receive.slow.values():
        yield slow.fields


def _received(keys: Any) -> FramePlan:
    received = keys.receive
    slow = list(received.slow.values())
    parts = [part for group in _groups(keys) for part in group.values()]
    parts += [received.counter, received.clock, received.status, *(group.counter for group in slow)]
    return FramePlan(
        _length(received, parts, keys.crc),
        [GroupPlan(received.fields), *(GroupPlan(group.fields, group.counter) for group in slow)],
        bytes.fromhex(received.head),
        keys.crc,
        received.counter,
        received.clock,
        received.status,
    )


def _sent(keys: Any) -> FramePlan:
    sent = keys.send
    length = _length(sent, [*sent.fields.values(), sent.counter], keys.crc)
    return FramePlan(length, [GroupPlan(sent.fields)], bytes.fromhex(sent.head), keys.crc, sent.counter)


def _length(section: Any, parts: Any, crc: Any) -> int:
    """Of a datagram, as the driver counts it; without `crc` what comes before its checksum."""
    if section.bytes is not None:
        return int(section.bytes)
    ends = [len(bytes.fromhex(section.head)), *(part.end for part in parts if part is not None)]
    return max(ends) + (crc.size if crc else 0)
