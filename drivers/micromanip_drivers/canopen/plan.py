"""What the configuration and the EDS files say together: nodes, their PDOs, the channels in them.

Mapping, EDS and configuration say where a signal lies in a PDO, and how its code becomes a number.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from collections.abc import Mapping as Names
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from canopen.objectdictionary import datatypes

from micromanip.driver import ConfigError, OutputRefused, did_you_mean

from ..canbus.bit_field import GREATEST, BitField
from ..canbus.plan import PackPlan
from .dictionary import Dictionary, number
from .mapping import Direction, Mapped, Mapping, mapping
from .options import CanOpenOptions, InputSignal, NodeOptions, OutputSignal, Rpdo, Tpdo

_FLOATS = {datatypes.REAL32: struct.Struct("<f"), datatypes.REAL64: struct.Struct("<d")}


def wire(name: str, mapped: Mapped, options: InputSignal) -> BitField:
    """How the signal `name` (for messages) travels as the object `mapped`."""
    variable, bits = mapped.variable, mapped.bits
    signed, floating = variable.data_type in datatypes.SIGNED_TYPES, _FLOATS.get(variable.data_type or 0)
    low: float
    high: float
    if floating is not None:
        low, high = -GREATEST[bits], GREATEST[bits]
    else:
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
        low = low if variable.min is None else max(low, variable.min)
        high = high if variable.max is None else min(high, variable.max)
    return BitField(
        name=name,
        big_endian=False,
        shift=mapped.first_bit,
        bits=bits,
        sign=1 << bits - 1 if signed else 0,
        floating=floating,
        scale=options.scale,
        offset=options.offset,
        low=low,
        high=high,
    )


SYNC = 0x80
_MOST_BYTES = 8


@dataclass(frozen=True)
class PdoPlan:
    """A PDO of a node, with the channels that travel in it."""

    node: str
    mapping: Mapping
    options: Tpdo | Rpdo
    wires: tuple[BitField, ...]
    safe: tuple[float, ...]
    """Of each wire of an RPDO: what it is kept at if it is not used."""
    carried: tuple[Mapped, ...]
    """The object of each wire."""

    @property
    def key(self) -> str:
        """Where it stands in the configuration."""
        return f"nodes.{self.node}.{self.mapping.direction}.{self.mapping.number}"

    @property
    def title(self) -> str:
        """For messages."""
        return f"{self.mapping.direction} {self.mapping.number} of node {self.node}"


@dataclass(frozen=True)
class NodePlan:
    """A node."""

    name: str
    options: NodeOptions
    dictionary: Dictionary
    tpdos: tuple[PdoPlan, ...]
    rpdos: tuple[PdoPlan, ...]

    @property
    def heartbeat_period_ms(self) -> int:
        """How often it is told to send its heartbeat."""
        return self.options.heartbeat_ms // 3

    @property
    def pdos(self) -> tuple[PdoPlan, ...]:
        """All its PDOs."""
        return self.tpdos + self.rpdos


def plan_nodes(options: CanOpenOptions, folder: Path) -> tuple[NodePlan, ...]:
    """All nodes. Raises ConfigError for what can't work; it begins with the key: "nodes.sensor.tpdo.1: ..."."""
    nodes = tuple(_node(name, node, folder) for name, node in options.nodes.items())
    for plan in nodes:
        _sync_agrees(plan, options.sync_hz)
        _watch_can_work(plan)
    _identifiers_differ(nodes)
    return nodes


def _node(name: str, options: NodeOptions, folder: Path) -> NodePlan:
    with _at(f"nodes.{name}.eds"):
        dictionary = Dictionary(folder / options.eds, options.node_id)
    tpdos = tuple(_pdo(name, dictionary, "tpdo", pdo, keys) for pdo, keys in options.tpdo.items())
    rpdos = tuple(_pdo(name, dictionary, "rpdo", pdo, keys) for pdo, keys in options.rpdo.items())
    with _at(f"nodes.{name}.eds"):
        dictionary.variable(0x1017)  # without a heartbeat it can't be watched
    _names_differ(name, options)
    return NodePlan(name, options, dictionary, tpdos, rpdos)


@contextmanager
def _at(key: str) -> Iterator[None]:
    """What is wrong in here is so at this key."""
    try:
        yield
    except ConfigError as problem:
        raise ConfigError(f"{key}: {problem}") from problem


def _pdo(node: str, dictionary: Dictionary, direction: Direction, pdo: int, options: Tpdo | Rpdo) -> PdoPlan:
    key = f"nodes.{node}.{direction}.{pdo}"
    with _at(key):
        laid = mapping(dictionary, direction, pdo, options)
    where = f"{dictionary.file}, {direction} {pdo}"
    carried: dict[str, Mapped] = {}
    signals: Names[str, InputSignal] = options.signals
    for name, signal in signals.items():
        with _at(f"{key}.signals.{name}"):
            found = _carried(signal.object or name, laid.objects, where)
        if other := next((other for other, mapped in carried.items() if mapped is found), None):
            raise ConfigError(f"{key}.signals.{name}: {where}: {name} and {other} are the same object")
        carried[name] = found
    if direction == "rpdo":
        missing = [m.variable.name for m in laid.objects if not m.is_dummy and m not in carried.values()]
        if missing:
            raise ConfigError(f"{key}.signals: {where} carries {', '.join(missing)} too, which signals does not name")
    wires = tuple(wire(f"{node}.{name}", carried[name], signal) for name, signal in signals.items())
    safe = tuple(signal.safe if isinstance(signal, OutputSignal) else 0.0 for signal in signals.values())
    if direction == "rpdo":
        for name, sent, value in zip(signals, wires, safe, strict=True):
            try:
                PackPlan([sent], _MOST_BYTES).data([value])
            except OutputRefused as problem:
                raise ConfigError(f"{key}.signals.{name}.safe: {problem}") from problem
    return PdoPlan(node, laid, options, wires, safe, tuple(carried[name] for name in signals))


def _carried(name: str, objects: Sequence[Mapped], where: str) -> Mapped:
    """The object of a PDO that is called `name`, or has that number."""
    by_number = {number(mapped.variable.index, mapped.variable.subindex).lower(): mapped for mapped in objects}
    if found := by_number.get(name.lower().removeprefix("0x")):
        return found
    called = {key: m for key, m in by_number.items() if name in (m.variable.name, m.variable.qualname)}
    if len(called) > 1:
        raise ConfigError(f"{where} carries several objects called {name}: give the number, {' or '.join(called)}")
    if called:
        return next(iter(called.values()))
    known = [mapped.variable.name for mapped in objects]
    hint = did_you_mean(name, known, "it carries")
    raise ConfigError(f"{where} carries no object called {name}; {hint}")


def _names_differ(node: str, options: NodeOptions) -> None:
    taken: dict[str, str] = {}
    for word, pdos in (("tpdo", options.tpdo), ("rpdo", options.rpdo)):
        for pdo, keys in pdos.items():
            for name in keys.signals:
                if name in taken:
                    raise ConfigError(f"nodes.{node}.{word}.{pdo}.signals.{name}: it is in {taken[name]} too")
                taken[name] = f"{word} {pdo}"


def _sync_agrees(plan: NodePlan, sync_hz: float | None) -> None:
    synchronous = [pdo for pdo in plan.pdos if pdo.mapping.synchronous]
    if synchronous and sync_hz is None:
        raise ConfigError(f"{synchronous[0].key}: {synchronous[0].title} goes with SYNC, which needs sync_hz")
    if synchronous and plan.dictionary.value(0x1005) & 0x7FF != SYNC:
        file = plan.dictionary.file
        raise ConfigError(f"nodes.{plan.name}.eds: {file} has SYNC elsewhere than at 0x80 (object 1005)")
    for pdo in plan.tpdos:
        if not pdo.mapping.synchronous or sync_hz is None:
            continue
        comes_hz = sync_hz / max(1, pdo.mapping.transmission)
        if pdo.mapping.transmission and abs(pdo.options.rate_hz - comes_hz) > 1e-6 * comes_hz:
            raise ConfigError(
                f"{pdo.key}.rate_hz: {pdo.title} comes at {comes_hz:g} Hz (sync_hz {sync_hz:g}, transmission "
                f"{pdo.mapping.transmission}), not rate_hz {pdo.options.rate_hz:g}"
            )


def _watch_can_work(plan: NodePlan) -> None:
    watchdog_ms, file = plan.options.watchdog_ms, plan.dictionary.file
    if watchdog_ms is None:
        return
    if plan.options.watchdog_by == "heartbeat":
        if not plan.dictionary.has(0x1016, 1):
            raise ConfigError(
                f"nodes.{plan.name}.watchdog_by: {file} has no 1016sub1, so it can't wait for a heartbeat"
            )
        return
    for pdo in plan.rpdos:
        if not plan.dictionary.has(pdo.mapping.parameters, 5):
            missing = number(pdo.mapping.parameters, 5)
            hint = "; watchdog_by: heartbeat is possible" if plan.dictionary.has(0x1016, 1) else ""
            raise ConfigError(
                f"nodes.{plan.name}.watchdog_ms: {file} has no {missing}, so it can't wait for that rpdo{hint}"
            )
        if watchdog_ms * 1e-3 * pdo.options.rate_hz < 3.0:
            raise ConfigError(
                f"nodes.{plan.name}.watchdog_ms: {pdo.title} is sent each {1e3 / pdo.options.rate_hz:g} ms; a "
                f"watchdog_ms of {watchdog_ms} would trip over one that is late: three periods are the least"
            )


def _identifiers_differ(nodes: Sequence[NodePlan]) -> None:
    taken: dict[int, str] = {}
    for pdo in (pdo for plan in nodes for pdo in plan.pdos):
        identifier = pdo.mapping.identifier
        if identifier in taken:
            raise ConfigError(
                f"{pdo.key}: {pdo.title} and {taken[identifier]} are both on identifier 0x{identifier:X}: give one "
                "of the nodes another node_id, or another EDS file"
            )
        taken[identifier] = pdo.title
