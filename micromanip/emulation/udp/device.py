"""A device that answers each datagram with one: it samples when it is asked, and takes the command.

While nothing is amiss compiled code serves its port (``serving.py``); what is rare, and every fault, goes through
Python: datagrams lost, doubled, late, corrupt, of strangers; the device silent, or without power
(``emulation/line/faults.py``). Both ways use the same plant, amplifier and counters.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from micromanip.bus.frame_plan import FramePlan, GroupPlan
from micromanip.emulation.amplifier import Amplifier
from micromanip.emulation.arrivals import gathered
from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.compiled_plant import fill_plant
from micromanip.emulation.emulated import EmulatedDevice, Surroundings, Wires
from micromanip.emulation.line.device_line import DeviceLine
from micromanip.emulation.line.fault import LineFault
from micromanip.emulation.line.faults import GcsError, Identity, parsed
from micromanip.emulation.line.number import LineNumber
from micromanip.emulation.line.port import Hear, Peer
from micromanip.emulation.line.udp_port import UdpPort
from micromanip.emulation.messages import MessageFigures
from micromanip.emulation.upkeep import Upkeep
from micromanip.errors import UsageError
from micromanip.rt.io.counting import OLD
from micromanip.rt.io.frames import MAX_BYTES
from micromanip.rt.jit import prepare
from micromanip.testbus.event_loop import EventLoop

from .serving import BAD, SERVED, compose, serve, understand

ANSWER = "receive"
"""What the device sends, by the name that commands use."""
_TURN_EACH_NS = 4_000_000
_PAUSE_NS = 50_000_000
"""Who has said nothing for so long begins anew."""
_PHASE_NS = 30_000
"""So old is the plant's state when it is asked for: a datagram that comes a little early still finds a new one."""


class UdpDevice:
    """The device of one driver `udp`."""

    def __init__(
        self, keys: Any, loop: EventLoop, cell: EmulatedCell, wires: Wires, amplifier: Amplifier | None
    ) -> None:
        """`keys` are the driver's options. Raises DeviceUnavailable for a port that is in use."""
        self._loop, self._cell, self._amplifier, self._keys = loop, cell, amplifier, keys
        self.figures = MessageFigures()
        self._outputs = [wires.outputs.get(channel) for channel in keys.send.fields]
        self._groups = [[wires.signals.get(name, name) for name in group] for group in _groups(keys)]
        self.signals = [signal for group in self._groups for signal in group]
        self._served = np.zeros(1, SERVED)
        self._fill(self._served[0])
        self._time_ns = self._served["time_ns"]
        self._data = np.zeros(MAX_BYTES, np.uint8)
        self._off_until_ns = self._silent_until_ns = self._counts_from_ns = 0.0
        self._began_ns, self._heard_ns = loop.now_ns(), 0
        self._upkeep = Upkeep(loop, self._look_after, _TURN_EACH_NS)
        prepare(serve, understand, compose)
        self._line = DeviceLine(loop, self._make_port)
        self._line.attach(self._hear)

    def _make_port(self, hear: Hear) -> UdpPort:
        keys = self._keys
        self._port = UdpPort(self._loop, keys.host, keys.port, keys.listen, hear, 1e6 * keys.link_Mbit_per_s)
        return self._port

    def _fill(self, d: Any) -> None:
        keys, plant = self._keys, self._cell.plant
        d["commands"], d["answers"] = _sent(keys).record()[0], _received(keys).record()[0]
        fill_plant(d, plant)
        d["counts"], d["counted"]["counts"] = 1 << 8 * keys.receive.counter.size, 1 << 8 * keys.send.counter.size
        d["unit_ns"] = keys.receive.clock.unit_us * 1e3 if keys.receive.clock else 1.0
        d["output"], d["signal"], d["group_signal"] = -1, -1, -1
        d["output"][: len(self._outputs)] = [plant.outputs.get(name or "", -1) for name in self._outputs]
        d["signal"][: len(self.signals)] = [plant.inputs.get(signal, -1) for signal in self.signals]
        d["group_signal"][: len(self._groups)] = [plant.inputs.get(group[0], -1) for group in self._groups]
        d["arrived"]["last"] = np.nan

    @property
    def ready(self) -> str:
        return f"{self._port.name}: answers each datagram, {len(self.signals)} signals, {len(self._outputs)} outputs"

    @property
    def messages(self) -> list[str]:
        return [ANSWER]

    def start(self, now_ns: int) -> None:
        self._began_ns = now_ns
        self._upkeep.start()

    def stop_counter(self, message: str, for_s: float | None) -> None:  # noqa: ARG002 (there is one)
        self._counts_from_ns = self._loop.end_ns(for_s)

    def silence(self, message: str, for_s: float | None) -> None:  # noqa: ARG002
        self._silent_until_ns = self._loop.end_ns(for_s)

    def reboot(self, for_s: float) -> None:
        now_ns = self._loop.now_ns()
        self._off_until_ns = now_ns + for_s * 1e9
        self._served["count"] = self._served["counted"]["known"] = 0
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
        self._gather()
        figures, port = self.figures, self._port.figures
        elapsed_ns = max(1, self._loop.now_ns() - self._began_ns)
        return {
            "frames": figures.sent + figures.received,
            **vars(figures),
            **vars(port),
            **{name: int(self._served[0]["counted"][name]) for name in ("lost", "doubled", "late", "restarts")},
            "bus_load_percent": round(100 * port.busy_ns / elapsed_ns, 2),
        }

    def close(self) -> None:
        self._line.close()

    def _readable(self) -> None:
        plant = self._cell.plant
        if not self._is_plain():
            self._gather()
            self._port.read()
            return
        self._time_ns[0] = plant.time_ns
        serve(self._served, *plant.arrays)
        plant.time_ns = int(self._time_ns[0])
        self._upkeep.behind_a_frame()

    def _is_plain(self) -> bool:
        """Whether a conversation is under way, and nothing is amiss."""
        now_ns = self._loop.now_ns()
        return (
            now_ns - self._heard_ns < _PAUSE_NS
            and now_ns >= max(self._off_until_ns, self._silent_until_ns, self._counts_from_ns)
            and self._cell.undisturbed
            and self._line.active(LineFault) is None
        )

    def _gather(self) -> None:
        """Take over what compiled code has done since the last time."""
        d = self._served[0]
        received, sent = int(d["received"]), int(d["sent"])
        if received == 0:
            return
        self.figures.received += received
        self.figures.sent += sent
        self.figures.not_understood += int(d["not_understood"])
        lengths = int(d["answers"]["length"]), int(d["commands"]["length"])
        self._port.carried(sent, lengths[0], received, lengths[1])
        d["received"] = d["sent"] = d["not_understood"] = 0
        self._heard_ns = int(d["heard_ns"])
        self._cell.plant.is_at(self._cell.plant.time_ns)
        if self._amplifier is not None:
            self._amplifier.refused += int(d["refused"])
            d["refused"] = 0
            self._amplifier.has_taken(dict(gathered(self._outputs, d["arrived"])), self._heard_ns)

    def _hear(self, data: bytes, peer: Peer) -> None:
        """One datagram, through Python."""
        now_ns, d = self._loop.now_ns(), self._served[0]
        if now_ns < self._off_until_ns:
            return
        length = min(len(data), MAX_BYTES)
        self._data[:length] = np.frombuffer(data, np.uint8, length)
        missing = understand(self._served, self._data, len(data))
        if missing == BAD:
            self._answer_who(data, peer)
            return
        self.figures.received += 1
        if now_ns - self._heard_ns > _PAUSE_NS:
            self._cell.advance_to(now_ns)
            self._cell.plant.begin(now_ns - _PHASE_NS)
        self._heard_ns = now_ns
        if missing != OLD and self._amplifier is not None:
            values = d["value"].tolist()
            named = zip(self._outputs, values, strict=False)
            self._amplifier.take({name: value for name, value in named if name is not None}, now_ns)
            d["arrived"]["last"] = d["value"]
        self._cell.advance_to(now_ns)  # up to now with what was in force, from now on with the command
        self._say(now_ns, peer)

    def _say(self, now_ns: int, peer: Peer) -> None:
        if now_ns < self._silent_until_ns:
            self.figures.silent += 1
            return
        d, cell, plant = self._served[0], self._cell, self._cell.plant
        d["time_ns"] = plant.time_ns
        d["reading"][: len(self.signals)] = [cell.read(signal) for signal in self.signals]
        for g, group in enumerate(self._groups):
            d["samples"][g] = plant.samples(group[0]) if group[0] in plant.inputs else 0
        if now_ns >= self._counts_from_ns:
            d["count"] = (d["count"] + 1) % d["counts"]
        compose(self._served)
        self._line.answer(peer, d["socket"]["sent"][: d["answers"]["length"]].tobytes())
        self.figures.sent += 1

    def _answer_who(self, data: bytes, peer: Peer) -> None:
        keys, seal = self._keys.identity, self._keys.crc
        if keys is None or not data.startswith(bytes.fromhex(keys.request)) or (seal and not seal.fits(data)):
            self.figures.not_understood += 1
            return
        frame = bytearray(_length(keys, keys.numbers.values(), None))
        head = bytes.fromhex(keys.head)
        frame[: len(head)] = head
        other = 1 if self._line.active(Identity) else 0
        for known in keys.numbers.values():
            LineNumber(known).write(frame, known.value ^ other)
        self._line.answer(peer, bytes(frame) + (seal.of(bytes(frame)) if seal else b""))

    def _look_after(self) -> None:
        """Amplifier and plant go on also while nobody asks."""
        self._gather()
        now_ns = self._loop.now_ns()
        self._cell.keep_up(now_ns)
        self._port.lend(self._served[0]["socket"], self._readable)


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
    parts += [
        received.counter,
        received.acknowledges,
        received.clock,
        received.status,
        *(group.counter for group in slow),
    ]
    return FramePlan(
        _length(received, parts, keys.crc),
        [GroupPlan(received.fields), *(GroupPlan(group.fields, group.counter) for group in slow)],
        bytes.fromhex(received.head),
        keys.crc,
        received.counter,
        received.clock,
        received.status,
        received.acknowledges,
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
    return int(max(ends) + (crc.size if crc else 0))
