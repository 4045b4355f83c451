"""The devices of a driver `canopen`: a node for each that the configuration names, with the bus that they are on."""

from __future__ import annotations

import configparser
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from canopen.objectdictionary import ObjectDictionaryError

from micromanip.emulation.amplifier import Amplifier
from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.emulated import EmulatedDevice, Surroundings, Wires
from micromanip.emulation.plant import PERIOD_NS
from micromanip.errors import UsageError

from .can_bus import CanBus
from .canopen_node import CanOpenNode

_IDLE_NS = 5_000_000
_NUMBER = re.compile(r"(?:0x)?([0-9A-Fa-f]{4})(?:sub([0-9A-Fa-f]{1,2}))?")


class EmulatedCanOpen(CanBus):
    """Nodes that boot, obey NMT and watch their commander by themselves."""

    def __init__(self, keys: Any, surroundings: Surroundings, wires: Wires) -> None:
        super().__init__(keys, surroundings.loop)
        self.nodes: dict[str, CanOpenNode] = {}
        self._cell = surroundings.cell
        self._off: set[str] = set()
        self.signals = list(wires.signals.values())
        self.messages: list[str] = []  # a PDO has no counter; one is silenced by dropping its identifier on the bus

    @property
    def ready(self) -> str:
        out, into = (sum(len(getattr(node, kind)) for node in self._keys.nodes.values()) for kind in ("tpdo", "rpdo"))
        return f"{self.described(out, into)}, nodes {', '.join(self.nodes)}"

    def start(self, now_ns: int) -> None:
        super().start(now_ns)
        self._go_on()

    def stop_counter(self, message: str, for_s: float | None) -> None:  # noqa: ARG002
        raise UsageError(f"{message} has no counter")

    def silence(self, message: str, for_s: float | None) -> None:  # noqa: ARG002
        raise UsageError(f"{message} can't be silenced by name: drop its identifier on the bus")

    def reboot(self, for_s: float) -> None:
        for name in self.nodes.keys() - self._off:
            self.nodes[name].detach()
            self._off.add(name)
        self._loop.call_at(self._loop.now_ns() + round(for_s * 1e9), self._power_on)

    def report(self) -> dict[str, Any]:
        return {**super().report(), "states": {name: node.state for name, node in self.nodes.items()}}

    def _go_on(self) -> None:
        """The plant moves too while nobody asks what it measures."""
        now_ns = self._loop.now_ns()
        self._cell.advance_to(now_ns)
        self._loop.call_at(now_ns + _IDLE_NS, self._go_on)

    def _power_on(self) -> None:
        for name in self._off:
            self.line.attach(self.nodes[name])
            self.nodes[name].reboot()
        self._off.clear()


def emulate_canopen(name: str, surroundings: Surroundings) -> EmulatedDevice:
    """Bus and nodes of the driver called `name`."""
    source, cell, loop = surroundings.source, surroundings.cell, surroundings.loop
    keys, wires = surroundings.options(name), surroundings.wires(name)
    # the nodes watch their commander themselves, and what is behind them does as they say
    amplifier = Amplifier(cell.plant, wires.rest_V, None)
    devices = EmulatedCanOpen(keys, surroundings, wires)
    cell.amplifiers.append(amplifier)
    try:
        for node, entry in keys.nodes.items():
            eds = source.path.parent / entry.eds
            behind = _Behind(cell, amplifier, dict(_named(node, entry, wires)))
            try:
                made = CanOpenNode(devices.line, loop, eds, entry.node_id, behind.measure, behind.write)
            except (OSError, ValueError, KeyError, TypeError, configparser.Error, ObjectDictionaryError) as problem:
                where = ("drivers", name, "nodes", node, "eds")
                raise source.error(where, f"{eds} can't be used: {problem}") from problem
            behind.resolve(made)
            devices.nodes[node] = made
    except BaseException:
        devices.close()
        raise
    return devices


class _Behind:
    """What stands behind one node: its objects' names to the cell's."""

    def __init__(self, cell: EmulatedCell, amplifier: Amplifier, names: dict[str, str]) -> None:
        self._cell, self._amplifier, self._names = cell, amplifier, names

    def resolve(self, node: CanOpenNode) -> None:
        """Objects that were given by number go by their name in the EDS too."""
        for given, name in list(self._names.items()):
            if match := _NUMBER.fullmatch(given):
                self._names[node.objects.variable(int(match[1], 16), int(match[2] or "0", 16)).name] = name

    def measure(self, names: Iterable[str]) -> list[float]:
        """Values of measured objects, now."""
        now_ns = self._cell.clock()
        if now_ns - self._cell.plant.time_ns >= PERIOD_NS:  # not for each answer to one SYNC
            self._cell.advance_to(now_ns)
        return [self._cell.read(self._names.get(name, name)) for name in names]

    def write(self, volts: Mapping[str, float]) -> None:
        """Values of outputs; one that the cell doesn't have does nothing."""
        named = {self._names.get(name, name): value for name, value in volts.items()}
        commands = {output: value for output, value in named.items() if output in self._cell.plant.outputs}
        if commands:
            now_ns = self._cell.clock()
            self._amplifier.take(commands, now_ns)
            self._cell.advance_to(now_ns)


def _named(node: str, keys: Any, wires: Wires) -> Iterator[tuple[str, str]]:
    """Objects of a node, by name or number in its EDS, with the names that the configuration gives them."""
    for pdo in (*keys.tpdo.values(), *keys.rpdo.values()):
        for signal, entry in pdo.signals.items():
            channel = f"{node}.{signal}"
            name = wires.signals.get(channel) or wires.outputs.get(channel) or signal
            eds_name = entry.object or signal
            yield eds_name, name
            yield eds_name.rsplit(".", 1)[-1], name
