"""From the configuration to transactions: registers that follow each other go in one; what these cost of the line."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from micromanip.driver import ConfigError, Load

from .codec import Field
from .exchange import Block, Exchange
from .framing import RtuFraming, TcpFraming
from .options import READS, WRITES, ModbusOptions, Register, Task, Unit

MOST = {1: 2000, 2: 2000, 3: 125, 4: 125, 5: 1, 6: 1, 15: 1968, 16: 123}
"""What one transaction carries, by function code: coils or registers."""
_MOST_READ_BY_23, _MOST_WRITTEN_BY_23 = 125, 121
STATUS, COUNTER = "status", "counter"
"""Names of those two among the fields of a transaction; a channel's name has a dot in it."""

_Row = tuple[int, str, Register]
"""Address as it goes over the wire, name or place, and what is there."""


@dataclass(frozen=True)
class TaskPlan:
    """A task of the configuration with its transactions, in the order in which they are done."""

    name: str
    """unit.task"""
    options: Task
    exchanges: tuple[Exchange, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def plan_tasks(options: ModbusOptions) -> list[TaskPlan]:
    """All of them. Raises ConfigError for registers that overlap or that no transaction can carry."""
    plans = []
    for name, unit in options.units.items():
        _refuse_overlaps(name, unit)
        plans += [_plan(name, unit, task, keys) for task, keys in unit.tasks.items()]
    return plans


def _plan(unit: str, device: Unit, task: str, keys: Task) -> TaskPlan:
    place = f"units.{unit}.tasks.{task}"
    inputs = {f"{unit}.{name}": register for name, register in keys.read.items()}
    outputs = {f"{unit}.{name}": register for name, register in keys.write.items()}
    also = {name: one for name, one in ((STATUS, keys.status), (COUNTER, keys.counter)) if one}
    read = _blocks(f"{place}.read", device, {**inputs, **also}, _MOST_READ_BY_23 if keys.write else MOST[keys.function])
    write = _blocks(f"{place}.write", device, outputs, MOST.get(keys.function, _MOST_WRITTEN_BY_23))
    pairs: list[tuple[Block | None, Block | None]]
    if keys.function in READS and keys.function in WRITES:
        for key, blocks in (("read", read), ("write", write)):
            if len(blocks) > 1:
                raise ConfigError(
                    f"{place}.{key}: function {keys.function} carries one block, and {blocks[0].fields[-1].name} and "
                    f"{blocks[1].fields[0].name} do not follow each other; name the registers between them, or use "
                    "functions of their own"
                )
        pairs = [(read[0], write[0])]
    elif also and len(read) > 1:
        raise ConfigError(
            f"{place}.{next(iter(also))}: it must come in one transaction with what it is about, and {len(read)} are "
            "needed; make a task of each group of registers that follow each other"
        )
    else:
        pairs = [(block, None) for block in read] + [(None, block) for block in write]
    exchanges = tuple(
        Exchange(device.unit_id, _title(unit, device, keys.function, *pair), keys.function, *pair) for pair in pairs
    )
    return TaskPlan(f"{unit}.{task}", keys, exchanges, tuple(inputs), tuple(outputs))


def _blocks(place: str, device: Unit, registers: Mapping[str, Register], most: int) -> list[Block]:
    """Registers in the order of their addresses, parted at gaps and where a transaction is full."""
    blocks: list[list[_Row]] = []
    first = end = 0
    rows = [(_address(f"{place}.{name}", device, one), name, one) for name, one in registers.items()]
    for address, name, register in sorted(rows, key=lambda row: row[0]):
        if not blocks or address > end or address + register.count - first > most:
            blocks.append([])
            first = end = address
        blocks[-1].append((address, name, register))
        end = max(end, address + register.count)
    return [_block(device, rows) for rows in blocks]


def _block(device: Unit, rows: list[_Row]) -> Block:
    first = rows[0][0]
    fields = tuple(
        Field(name, register, address - first, device.byte_order, device.word_order) for address, name, register in rows
    )
    return Block(first, max(address + register.count for address, _, register in rows) - first, fields)


def _address(place: str, device: Unit, register: Register) -> int:
    address = register.address - device.address_base
    if not 0 <= address <= 0x10000 - register.count:
        raise ConfigError(
            f"{place}: address {register.address} with address_base "
            f"{device.address_base} would be {address} on the wire, which has 0 to 65535"
        )
    return address


def _refuse_overlaps(unit: str, device: Unit) -> None:
    """Of what is read from each table, and of what is written to it."""
    groups: dict[tuple[str, str], list[_Row]] = {}
    named: dict[tuple[str, str], str] = {}
    for task, keys in device.tasks.items():
        for kind, tables, registers in (("read", READS, keys.read), ("write", WRITES, keys.write)):
            for name, register in registers.items():
                place = f"units.{unit}.tasks.{task}.{kind}.{name}"
                first = named.setdefault((kind, name), task)
                if first != task:
                    raise ConfigError(f"{place}: task {first} has a {name} already; channels are called unit.register")
                table = tables[keys.function]
                groups.setdefault((kind, table), []).append((_address(place, device, register), place, register))
    for rows in groups.values():
        for one, other in _neighbours(sorted(rows, key=lambda row: row[0])):
            if _overlap(one, other):
                raise ConfigError(f"{other[1]}: overlaps with {one[1]}: both take {_span(other)}")


def _neighbours(rows: list[_Row]) -> Iterator[tuple[_Row, _Row]]:
    """Pairs that may overlap: a number has four registers at most."""
    for i, row in enumerate(rows):
        for other in rows[i + 1 : i + 20]:
            yield row, other


def _overlap(one: _Row, other: _Row) -> bool:
    if other[0] >= one[0] + one[2].count:
        return False
    if one[2].type == other[2].type == "bits":
        return bool(one[2].mask & other[2].mask)
    return True


def _span(row: _Row) -> str:
    return f"{'bit ' + str(row[2].first_bit) + ' of ' if row[2].type == 'bits' else ''}register {row[2].address}"


def _title(unit: str, device: Unit, function: int, read: Block | None, write: Block | None) -> str:
    spans = []
    for block in (read, write):
        if block is not None:
            first = block.first + device.address_base
            spans.append(f"{first}" if block.count == 1 else f"{first} to {first + block.count - 1}")
    return f"{unit} (unit {device.unit_id}), function {function}, {' and '.join(spans)}"


_ETHERNET_BITS = (14 + 20 + 20 + 4 + 8 + 12) * 8
"""Of a packet beside its Modbus frame: Ethernet, IP and TCP, with preamble and gap."""
_LEAST_ETHERNET_BITS = 84 * 8
_GAP_CHARACTERS, _LEAST_GAP_S = 3.5, 1.75e-3
"""Silence between the frames of a serial line; the least is for rates above 19200 baud."""
_FAST_BAUD = 19_200
_LIMIT = 0.9
"""A polled line has one master and no collisions: it may be filled further than a bus that several share."""


class Timing:
    """Of all transactions, at worst."""

    def __init__(self, options: ModbusOptions) -> None:
        self._options = options
        self._response_s = options.response_ms * 1e-3
        self.gap_s = 0.0
        """Silence before each request."""
        if serial := options.serial:
            gap_s = _GAP_CHARACTERS * serial.bits_per_byte / serial.baud
            own_s = serial.rs485.turnaround_us * 1e-6 if serial.rs485 else 0.0
            self.gap_s = max(own_s, gap_s if serial.baud <= _FAST_BAUD else _LEAST_GAP_S)

    def request_s(self, exchange: Exchange) -> float:
        """The request on the wire."""
        return self._wire_s(exchange.request_bytes)

    def answer_s(self, exchange: Exchange) -> float:
        """The answer on the wire."""
        return self._wire_s(exchange.answer_bytes)

    def taken_s(self, exchange: Exchange) -> float:
        """From the beginning of the request to the end of the answer."""
        return self.request_s(exchange) + self._response_s + self.answer_s(exchange)

    def busy_s(self, exchange: Exchange) -> float:
        """For how long it keeps the line: a serial one is silent after each frame."""
        return self.taken_s(exchange) + 2.0 * self.gap_s

    def input_latency_s(self, plan: TaskPlan) -> float:
        """From being asked for to being received: half of the response time is between the two, on the average."""
        return 0.5 * self._response_s + max(map(self.answer_s, plan.exchanges))

    def output_latency_s(self, plan: TaskPlan) -> float:
        """From being sent to being taken by the device."""
        before_s = sum(map(self.busy_s, plan.exchanges[:-1]))
        return before_s + self.request_s(plan.exchanges[-1]) + 0.5 * self._response_s

    def load(self, plans: Iterable[TaskPlan]) -> Load:
        """The line's load."""
        parts = [(plan.options.rate_hz, self.busy_s(exchange)) for plan in plans for exchange in plan.exchanges]
        kinds = dict.fromkeys(parts)
        detail = " + ".join(
            f"{parts.count(kind) * kind[0]:g} x {1e3 * kind[1]:.3g} ms (answers begun within "
            f"{self._options.response_ms:g} ms)"
            for kind in kinds
        )
        return Load(self._options.device, sum(rate_hz * busy_s for rate_hz, busy_s in parts), detail, _LIMIT)

    def refuse_short_timeout(self, plans: Iterable[TaskPlan]) -> None:
        """Raise ConfigError where answers that are in time would count as late."""
        for plan in plans:
            needed_ms = 1e3 * max(map(self.taken_s, plan.exchanges))
            if self._options.timeout_ms < needed_ms:
                raise ConfigError(
                    f"timeout_ms: {self._options.timeout_ms:g} ms is over before {plan.name} can be answered, which "
                    f"takes up to {needed_ms:.3g} ms"
                )

    def _wire_s(self, pdu_bytes: int) -> float:
        if serial := self._options.serial:
            return (pdu_bytes + RtuFraming.overhead_bytes) * serial.bits_per_byte / serial.baud
        assert self._options.tcp is not None
        bits = _ETHERNET_BITS + (pdu_bytes + TcpFraming.overhead_bytes) * 8
        return max(bits, _LEAST_ETHERNET_BITS) / (self._options.tcp.link_Mbit_per_s * 1e6)
