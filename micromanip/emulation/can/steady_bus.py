"""One test bus and its device, lent to compiled code as a row of a table, and taken back out of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from micromanip.bus.datagram_socket import lend
from micromanip.emulation.arrivals import gathered
from micromanip.emulation.cell import EmulatedCell
from micromanip.rt.wire.records import BATCH
from micromanip.testbus.client_port import ClientPort
from micromanip.testbus.frame import EXTENDED_FLAG, pack, unpack
from micromanip.testbus.hub import CanHub
from micromanip.testbus.port import Port, Transmission
from micromanip.testbus.wire import Standing

from .canbus import DbcMessage, EmulatedCanBus
from .frames import ONE, STAMP_BYTES, ZERO, fill_field, has_tables
from .records import FAR_NS, LENGTHS, MAX_CLIENTS, MAX_FIELDS, MAX_MESSAGES, NOBODY


class SteadyBus:
    """One test bus, its device and its row."""

    def __init__(self, emulated: EmulatedCanBus, hub: CanHub) -> None:
        self._device, self._hub = emulated.device, hub
        self._row: Any = None
        self._clients: list[ClientPort] = []
        self._ports: list[Port] = []
        outputs = self._device.outputs
        self._outputs = [(message, list(outputs[message.name].items())) for message in self._device.received]

    @property
    def has_room(self) -> bool:
        """Whether the tables hold it."""
        sent, received = self._device.sent, self._device.received
        fields = sum(len(one.signals) for one in sent) + sum(len(outputs) for _, outputs in self._outputs)
        layouts = [one.message.layout for one in sent] + [one.layout for one in received]
        return max(len(sent), len(received)) <= MAX_MESSAGES and fields <= MAX_FIELDS and all(map(has_tables, layouts))

    def describe(self, row: Any, cell: EmulatedCell) -> None:
        """Write into `row`, which is its own from now on, what does not change."""
        self._row, plant = row, cell.plant
        row["messages"], row["commands"] = len(self._device.sent), len(self._device.received)
        row["fd"], row["sender"] = self._hub.data_bitrate is not None, NOBODY
        row["duration_ns"] = list(self._durations())
        first = 0
        for t, sent in zip(row["message"], self._device.sent, strict=False):
            message, channels = sent.message, {name: _input(plant, signal) for name, signal in sent.signals.items()}
            first += _describe(t, row, first, message, channels)
            frame = message.carrying(bytes(message.layout.length))
            packet = bytes(STAMP_BYTES) + pack(frame)
            t["bytes"], t["empty"][: len(packet)] = len(packet), np.frombuffer(packet, np.uint8)
            t["priority"], t["period_ns"] = frame.priority, sent.period_ns
            t["duration_ns"] = self._transmission(pack(frame), 0).duration_ns
            if message.counter is not None:
                counter = message.layout.get_signal_by_name(message.counter)
                fill_field(t["counter"], counter, message.ends[counter.name], ZERO)
        for t, (message, outputs) in zip(row["command"], self._outputs, strict=False):
            t["word"] = message.identifier | (EXTENDED_FLAG if message.extended else 0)
            t["length"] = message.layout.length
            taken = outputs if self._device.amplifier is not None else []
            first += _describe(t, row, first, message, {name: plant.outputs[output] for name, output in taken})

    @property
    def has_other_clients(self) -> bool:
        """Whether others are connected than those that it was lent with."""
        return list(self._hub.clients) != self._clients

    @property
    def heard_by_others(self) -> Sequence[int]:
        """Descriptors of clients whose frames others wait for."""
        c = self._row["client"][: self._row["clients"]]
        return c["socket"]["descriptor"].tolist() if len(c) > 1 else ()

    def is_plain(self, now_ns: int) -> bool:
        """Whether nothing is amiss, and the tables hold what waits."""
        hub, device = self._hub, self._device
        clients = list(hub.clients)
        ports = [hub.nodes()[id(node)] for node in (device, *device.sent)]
        return (
            hub.is_plain
            and len(clients) <= MAX_CLIENTS
            and hub.wire.ports_are(ports, clients)
            and now_ns >= device.off_until_ns
            and all(periodic.is_plain(now_ns) for periodic in device.periodic)
            and not ports[0].queue
            and all(len(port.queue) <= 1 for port in ports[1:])
            and all(len(client.queue) < BATCH for client in clients)
        )

    def lend(self, now_ns: int) -> None:
        """Into the row, all as it stands."""
        row, hub, device = self._row, self._hub, self._device
        self._clients = list(hub.clients)
        self._ports = [hub.nodes()[id(sent)] for sent in device.sent]
        standing = hub.wire.lend()
        row["clients"], row["sender"] = len(self._clients), NOBODY
        row["end_ns"], row["free_ns"] = FAR_NS, standing.free_ns
        if standing.on_air is not None:
            port, transmission = standing.on_air
            port.queue.appendleft(transmission)
            row["sender"], row["end_ns"] = self._number(port), standing.end_ns
        for t, sent, port, periodic in zip(row["message"], device.sent, self._ports, device.periodic, strict=False):
            periodic.pause()
            t["count"], t["due_ns"], t["waits"] = sent.count, sent.due_ns, len(port.queue)
            for waiting in port.queue:
                t["packet"][STAMP_BYTES : STAMP_BYTES + len(waiting.packed)] = np.frombuffer(waiting.packed, np.uint8)
                t["arrival_ns"] = waiting.arrival_ns
            port.queue.clear()
        self._remember_last()
        for c, client in zip(row["client"], self._clients, strict=False):
            lend(client.lend(), c["socket"])
            c["waiting"], c["next"], c["heard_ns"], c["dropped"] = len(client.queue), 0, now_ns, 0
            for k, waiting in enumerate(client.queue):
                packet = waiting.arrival_ns.to_bytes(STAMP_BYTES, "little") + waiting.packed
                c["socket"]["received"][k][: len(packet)] = np.frombuffer(packet, np.uint8)
                c["socket"]["message"][k]["length"], c["socket"]["message"][k]["flags"] = len(packet), 0
            client.queue.clear()

    def take_back(self) -> None:
        """Out of the row, all as it stands."""
        row, device, sender = self._row, self._device, int(self._row["sender"])
        on_air: tuple[Port, Transmission] | None = None
        for m, (sent, port) in enumerate(zip(device.sent, self._ports, strict=True)):
            t = row["message"][m]
            sent.count, sent.due_ns = int(t["count"]), int(t["due_ns"])
            if t["waits"]:
                waiting = self._transmission(t["packet"][STAMP_BYTES : t["bytes"]], int(t["arrival_ns"]))
                if sender == MAX_CLIENTS + m:
                    on_air = port, waiting
                else:
                    port.queue.append(waiting)
        for periodic in sorted(
            device.periodic, key=lambda one: -one.message.period_ns
        ):  # as they would have been asked for
            periodic.go_on()
        for i, client in enumerate(self._clients):
            c = row["client"][i]
            packets = list(_packets(c))
            if sender == i:
                first = packets.pop(0)
                on_air = client, self._transmission(first[STAMP_BYTES:], int.from_bytes(first[:STAMP_BYTES], "little"))
            client.take_back(packets, int(c["dropped"]))
        self._hub.wire.take_back(Standing(on_air, int(row["end_ns"]), int(row["free_ns"])))

    def gather(self) -> None:
        """Add to the figures of device and bus what compiled code has done."""
        row, figures, statistics = self._row, self._device.figures, self._hub.statistics
        statistics.frames += int(row["frames"])
        statistics.busy_ns += int(row["busy_ns"])
        figures.sent += int(row["message"]["sent"].sum())
        figures.received += int(row["received"])
        figures.not_understood += int(row["not_understood"])
        amplifier = self._device.amplifier
        if amplifier is not None:
            amplifier.refused += int(row["refused"])
            if row["heard_ns"] > 0:
                amplifier.has_taken(dict(self._arrived()), int(row["heard_ns"]))
        row["frames"] = row["busy_ns"] = row["received"] = row["not_understood"] = row["refused"] = row["heard_ns"] = 0
        row["message"]["sent"] = 0

    def _remember_last(self) -> None:
        """What each output was given last, for its next step."""
        amplifier = self._device.amplifier
        given = {} if amplifier is None else amplifier.arrived | amplifier.switches
        for t, (_, outputs) in zip(self._row["command"], self._outputs, strict=False):
            for field, (_, output) in zip(self._row["field"][t["field"] :], outputs, strict=False):
                field["arrived"]["last"] = given[output].last if output in given else math.nan

    def _arrived(self) -> Iterator[tuple[str, Any]]:
        for t, (_, outputs) in zip(self._row["command"], self._outputs, strict=False):
            fields = self._row["field"][t["field"] : t["field"] + t["fields"]]
            yield from gathered([output for _, output in outputs], fields["arrived"])

    def _number(self, port: Port) -> int:
        """Of a port as a sender in the row."""
        ports: list[Port] = [*self._clients, *self._ports]
        i = next(i for i, other in enumerate(ports) if other is port)
        return i if i < len(self._clients) else MAX_CLIENTS + i - len(self._clients)

    def _transmission(self, packed: Any, arrival_ns: int) -> Transmission:
        return self._hub.wire.transmission(unpack(bytes(packed)), bytes(packed), arrival_ns)

    def _durations(self) -> Iterator[list[list[int]]]:
        for extended in (False, True):
            yield [
                [self._duration_ns(length, extended, fd, switches) for length in range(LENGTHS)]
                for fd, switches in ((False, False), (True, False), (True, True))
            ]

    def _duration_ns(self, length: int, extended: bool, fd: bool, switches: bool) -> int:
        """0 for a frame that there is not."""
        if (fd and self._hub.data_bitrate is None) or (not fd and length > 8):
            return 0
        return self._hub.wire.duration_ns(length, extended, fd, switches)


def _describe(t: Any, row: Any, first: int, message: DbcMessage, channels: Mapping[str, int]) -> int:
    """The signals of a message or command, in the bus' fields from `first` on; how many there are."""
    for field, (name, channel) in zip(row["field"][first:], channels.items(), strict=False):
        fill_field(field, message.layout.get_signal_by_name(name), message.ends[name], channel)
    t["field"], t["fields"] = first, len(channels)
    return len(channels)


def _input(plant: Any, signal: str) -> int:
    """What fills a signal while nothing is amiss, as ``EmulatedCell.read`` has it."""
    number: int = plant.inputs.get(signal, ONE if signal.startswith("amplifier_ok") else ZERO)
    return number


def _packets(c: Any) -> Iterator[bytes]:
    """What was read of a client, and not dealt with."""
    for k in range(int(c["next"]), int(c["waiting"])):
        length = min(int(c["socket"]["message"][k]["length"]), c["socket"]["received"].shape[1])
        yield c["socket"]["received"][k][:length].tobytes()
