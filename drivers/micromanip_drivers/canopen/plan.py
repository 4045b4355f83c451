"""What the configuration and the EDS files say together: nodes, their PDOs, the channels in them, what these cost.

Mapping, EDS and configuration say where a signal lies in a PDO, and how its code becomes a number.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Mapping as Names
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from canopen.objectdictionary import datatypes

from micromanip.driver import ConfigError, OutputRefused, did_you_mean, worst_case_s

from ..canbus.plan import GREATEST, BitField, PackPlan
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
        objects = [m for m in laid.objects if m.variable.index >= 0x20]  # those below stand for gaps
        missing = [m.variable.name for m in objects if m not in carried.values()]
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


_HEARTBEAT = 0x700


@dataclass(frozen=True)
class Frame:
    """A frame that comes again and again."""

    kind: str
    identifier: int
    rate_hz: float
    seconds: float
    """How long it keeps the bus, at worst."""


class Timing:
    """The frames that the configuration asks for."""

    def __init__(self, options: CanOpenOptions, nodes: Sequence[NodePlan]) -> None:
        self._options = options
        self.frames = tuple(_frames(options, nodes))

    def duration_s(self, length: int) -> float:
        """How long a frame of `length` bytes keeps the bus, at worst."""
        return worst_case_s(length, self._options.bitrate)

    def load(self) -> tuple[float, str, float]:
        """The bus's load: share, how it comes about, frames a second."""
        groups: dict[tuple[str, float], float] = {}
        for frame in self.frames:
            group = frame.kind, frame.seconds
            groups[group] = groups.get(group, 0.0) + frame.rate_hz
        detail = " + ".join(
            f"{rate_hz:.0f} {kind} x {seconds * 1e6:.0f} us" for (kind, seconds), rate_hz in groups.items()
        )
        share = sum(frame.rate_hz * frame.seconds for frame in self.frames)
        return share, detail, sum(frame.rate_hz for frame in self.frames)

    def arrival_s(self, identifier: int) -> float:
        """From being ready to being received, at worst: behind a frame that is on the bus, and all that go first.

        A SYNC makes all synchronous PDOs ready at once, so the SYNC is one of them.
        """
        ahead = sum(frame.seconds for frame in self.frames if frame.identifier <= identifier)
        behind = max((frame.seconds for frame in self.frames if frame.identifier > identifier), default=0.0)
        return ahead + behind

    def input_latency_s(self, pdo: PdoPlan) -> float:
        """From being measured to being received, at worst."""
        return pdo.options.latency_us * 1e-6 + self.arrival_s(pdo.mapping.identifier)

    def output_latency_s(self, pdo: PdoPlan) -> float:
        """From being sent to being in force, at worst: a synchronous one waits for the next SYNC."""
        waits_s = 1.0 / self._options.sync_hz if pdo.mapping.synchronous and self._options.sync_hz else 0.0
        return pdo.options.latency_us * 1e-6 + self.arrival_s(pdo.mapping.identifier) + waits_s


def _frames(options: CanOpenOptions, nodes: Sequence[NodePlan]) -> Iterable[Frame]:
    if options.sync_hz is not None:
        yield Frame("SYNC", SYNC, options.sync_hz, worst_case_s(0, options.bitrate))
    for plan in nodes:
        for pdo in plan.pdos:
            seconds = worst_case_s(pdo.mapping.length, options.bitrate)
            yield Frame(pdo.mapping.direction.upper(), pdo.mapping.identifier, pdo.options.rate_hz, seconds)
    beat_s = worst_case_s(1, options.bitrate)
    for plan in nodes:
        yield Frame("heartbeat", _HEARTBEAT + plan.options.node_id, 1e3 / plan.heartbeat_period_ms, beat_s)
    if options.heartbeat_period_ms is not None:
        yield Frame("heartbeat", _HEARTBEAT + options.own_node_id, 1e3 / options.heartbeat_period_ms, beat_s)
