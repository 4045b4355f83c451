"""A device that answers each datagram with one: it samples when it is asked, and takes the command.

While nothing is amiss compiled code serves its port (``serving.py``); what is rare, and every fault, goes through
Python: datagrams lost, doubled, late, corrupt, of strangers; the device silent, or without power
(``emulation/line/faults.py``). Both ways use the same plant, amplifier and counters.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from micromanip.emulation.amplifier import Amplifier
from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.emulated import EmulatedDevice, Surroundings, Wires
from micromanip.emulation.line.binary_frame import LineNumber
from micromanip.emulation.line.device import ServedDevice
from micromanip.emulation.line.device_line import DeviceLine
from micromanip.emulation.line.faults import parsed
from micromanip.emulation.line.port import Hear, Peer, UdpPort
from micromanip.emulation.plant import fill_plant
from micromanip.errors import UsageError
from micromanip.rt.io.counting import OLD
from micromanip.rt.io.frames import MAX_BYTES
from micromanip.rt.jit import prepare
from micromanip.testbus.event_loop import EventLoop

from .serving import BAD, SERVED, compose, serve, understand

ANSWER = "receive"
"""What the device sends, by the name that commands use."""
_TURN_EACH_NS = 4_000_000


class UdpDevice(ServedDevice):
    """The device of one driver `udp`."""

    def __init__(
        self, driver: Any, keys: Any, loop: EventLoop, cell: EmulatedCell, wires: Wires, amplifier: Amplifier | None
    ) -> None:
        """`keys` are the options of `driver`. Raises DeviceUnavailable for a port that is in use."""
        super().__init__(keys, loop, cell, amplifier, _TURN_EACH_NS)
        self._outputs = [wires.outputs.get(channel) for channel in keys.send.fields]
        self._groups = [[wires.signals.get(name, name) for name in group] for group in _groups(keys)]
        self.signals = [signal for group in self._groups for signal in group]
        self._served = np.zeros(1, SERVED)
        self._fill(self._served[0], driver.record(driver.context()))
        self._time_ns = self._served["time_ns"]
        self._data = np.zeros(MAX_BYTES, np.uint8)
        self._off_until_ns = self._counts_from_ns = 0.0
        prepare(serve, understand, compose)
        self._line = DeviceLine(loop, self._make_port)
        self._lines = [self._line]
        self._line.attach(self._hear)

    def _make_port(self, hear: Hear) -> UdpPort:
        keys = self._keys
        self._port = UdpPort(self._loop, keys.host, keys.port, keys.listen, hear, 1e6 * keys.link_Mbit_per_s)
        return self._port

    def _fill(self, d: Any, c: Any) -> None:
        """Of the device `d`, by the tables `c` of the driver."""
        plant = self._cell.plant
        d["commands"], d["answers"] = c["send"], c["receive"]
        d["counts"], d["counted"]["counts"] = c["counted"]["counts"], c["counts"]
        d["unit_ns"] = c["clock"]["unit_ns"] or 1.0
        fill_plant(d, plant)
        d["output"], d["signal"], d["group_signal"] = -1, -1, -1
        d["output"][: len(self._outputs)] = [plant.outputs.get(name or "", -1) for name in self._outputs]
        d["signal"][: len(self.signals)] = [plant.inputs.get(signal, -1) for signal in self.signals]
        d["group_signal"][: len(self._groups)] = [plant.inputs.get(group[0], -1) for group in self._groups]
        self.count_in(self._outputs, d["arrived"])

    @property
    def ready(self) -> str:
        return f"{self._port.name}: answers each datagram, {len(self.signals)} signals, {len(self._outputs)} outputs"

    @property
    def messages(self) -> list[str]:
        return [ANSWER]

    def stop_counter(self, message: str, for_s: float | None) -> None:  # noqa: ARG002 (there is one)
        self._counts_from_ns = self._loop.end_ns(for_s)

    def reboot(self, for_s: float) -> None:
        now_ns = self._loop.now_ns()
        self._off_until_ns = now_ns + for_s * 1e9
        self._served["count"] = self._served["counted"]["known"] = 0
        if self._amplifier is not None:
            self._amplifier.trip(now_ns)

    def inject(self, fault: Mapping[str, Any]) -> None:
        injected = parsed(dict(fault))
        if injected.kind == "gcs_error":
            raise UsageError(f"fault {injected.kind}: {self.ready} has nothing of the kind")
        self._line.inject(injected)

    def clear(self) -> None:
        super().clear()
        self._counts_from_ns = 0.0

    def report(self) -> dict[str, Any]:
        report, counted = super().report(), self._served[0]["counted"]
        return report | {name: int(counted[name]) for name in ("lost", "doubled", "late", "restarts")}

    def _readable(self) -> None:
        plant = self._cell.plant
        if not self.is_plain(self._loop.now_ns()):
            self._gather()
            self._port.read()
            return
        self._time_ns[0] = plant.time_ns
        serve(self._served, *plant.arrays)
        plant.time_ns = int(self._time_ns[0])
        self._upkeep.behind_a_frame()

    def is_plain(self, now_ns: int) -> bool:
        return now_ns >= max(self._off_until_ns, self._counts_from_ns) and super().is_plain(now_ns)

    def _gather(self) -> None:
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
        self.has_taken(d)

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
        self.hears(now_ns)
        if missing != OLD and self._amplifier is not None:
            values = d["value"].tolist()
            named = zip(self._outputs, values, strict=False)
            self._amplifier.take({name: value for name, value in named if name is not None}, now_ns)
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
        head, crc_size = bytes.fromhex(keys.head), seal.size if seal else 0
        end = max([len(head), *(known.end for known in keys.numbers.values())])
        frame = bytearray(keys.bytes - crc_size if keys.bytes else end)
        frame[: len(head)] = head
        other = 1 if self._line.active("identity") else 0
        for known in keys.numbers.values():
            LineNumber(known).write(frame, known.value ^ other)
        self._line.answer(peer, bytes(frame) + (seal.of(bytes(frame)) if seal else b""))

    def _look_after(self) -> None:
        self._gather()
        now_ns = self._loop.now_ns()
        self._cell.keep_up(now_ns)
        self._port.lend(self._served[0]["socket"], self._readable)


def emulate_udp(name: str, surroundings: Surroundings) -> EmulatedDevice:
    """The device of the driver called `name`."""
    wires = surroundings.wires(name)
    driver, keys = surroundings.built(name)
    return UdpDevice(driver, keys, surroundings.loop, surroundings.cell, wires, surroundings.amplifier(wires))


def _groups(keys: Any) -> Iterator[Mapping[str, Any]]:
    yield keys.receive.fields
    for slow in keys.receive.slow.values():
        yield slow.fields
