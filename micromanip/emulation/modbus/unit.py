"""The memory of a simulated Modbus unit: tables of registers and coils, filled by sensors, watched for commands.

A register is a number with type, orders, scale and offset, as configured.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from micromanip.bus.number_options import SIZES
from micromanip.emulation.line.binary_frame import LineNumber
from micromanip.emulation.line.device import Behind


@dataclass(frozen=True)
class _Keys:
    """A number in a frame of its own, the highest byte first."""

    type: str
    size: int
    end: int
    scale: float
    offset: float
    at: int = 0
    byte_order: str = "big"


class DeviceRegister(LineNumber):
    """value = scale x number + offset."""

    def __init__(self, name: str, unit: Any, entry: Any) -> None:
        """`unit` and `entry` are the driver's keys."""
        self.name, self.is_bits = name, entry.type == "bits"
        self.address: int = entry.address - unit.address_base
        """As it goes over the wire."""
        few = self.is_bits or entry.type == "coil"
        kind = "uint16" if few else entry.type
        self.width = SIZES[kind] // 2
        """How many registers, or coils, it takes."""
        self._shift, self._big_words = getattr(entry, "first_bit", None) or 0, unit.word_order == "big"
        self._big_bytes = unit.byte_order == "big" or entry.type == "coil"
        scale, offset = getattr(entry, "scale", 1.0), getattr(entry, "offset", 0.0)
        super().__init__(_Keys(kind, SIZES[kind], SIZES[kind], scale, offset))
        if few:
            self.low, self.high = 0, (1 << getattr(entry, "bit_count", 1)) - 1
        self.mask = self.code_words(self.high)[0] if self.is_bits else 0xFFFF
        """Bits of its registers that it takes, as they go over the wire."""

    def words(self, value: float) -> Sequence[int]:
        """The registers that hold a value, the nearest that they can; NaN as such, or as the largest number."""
        frame = bytearray(2 * self.width)
        self.put(frame, value)
        return self._ordered(frame)

    def code_words(self, code: float) -> Sequence[int]:
        """The registers that hold a number, without scale."""
        frame = bytearray(2 * self.width)
        self.write(frame, code)
        return self._ordered(frame)

    def value(self, words: Sequence[int]) -> float:
        """What its registers say."""
        return self.get(struct.pack(f">{self.width}H", *self._ordered(struct.pack(f">{self.width}H", *words))))

    def read(self, data: bytes | bytearray, at: int = 0) -> float:
        number = super().read(data, at)
        return int(number) >> self._shift & int(self.high) if self.is_bits else number

    def write(self, data: bytearray, number: float) -> None:
        super().write(data, int(number) << self._shift if self.is_bits else number)

    def _ordered(self, frame: bytes | bytearray) -> Sequence[int]:
        """The highest first, to registers in the device's order; and back."""
        words = struct.unpack(f">{self.width}H", frame)
        words = words if self._big_words else words[::-1]
        return words if self._big_bytes else [(word & 0xFF) << 8 | word >> 8 for word in words]


COILS, INPUTS, HOLDING, INPUT_REGISTERS = "coils", "discrete inputs", "holding registers", "input registers"
COUNT_EVERY_NS = 1_000_000
"""It measures anew so often: so its counters go."""
_READ = {1: COILS, 2: INPUTS, 3: HOLDING, 4: INPUT_REGISTERS, 23: HOLDING}
_WRITTEN = {5: COILS, 6: HOLDING, 15: COILS, 16: HOLDING, 23: HOLDING}
"""Table that each function code reads or writes."""


class ModbusUnit:
    """Registers that no configuration names do not exist."""

    def __init__(self, name: str, behind: Behind) -> None:
        self.name = name
        self.silent_until_ns: float = 0
        self.counts_from_ns: float = 0
        """Until then its counters stand still."""
        self.is_another = False
        """It says that it is another device."""
        self._behind = behind
        self._measured: dict[str, list[tuple[DeviceRegister, str]]] = {}
        self._constant: dict[str, list[tuple[DeviceRegister, int]]] = {}
        self._counters: dict[str, list[DeviceRegister]] = {}
        self._outputs: dict[str, list[tuple[DeviceRegister, str]]] = {}
        self._memory: dict[str, dict[int, int]] = {}
        self._plans: dict[tuple[str, int, int], list[tuple[DeviceRegister, str]]] = {}
        self._count = 0

    @property
    def registers(self) -> int:
        """How many there are, in all tables."""
        return sum(map(len, self._memory.values()))

    def add_measured(self, table: str, register: DeviceRegister, channel: str) -> None:
        """A register that a sensor fills, by the driver's name for it."""
        self._measured.setdefault(table, []).append((register, channel))
        self._exists(table, register)

    def add_constant(self, table: str, register: DeviceRegister, code: int) -> None:
        """A register that always says the same."""
        self._constant.setdefault(table, []).append((register, code))
        self._exists(table, register)

    def add_counter(self, table: str, register: DeviceRegister) -> None:
        """A register that counts the measurements."""
        self._counters.setdefault(table, []).append(register)
        self._exists(table, register)

    def add_output(self, table: str, register: DeviceRegister, channel: str) -> None:
        """A register that commands an output, by the driver's name for it."""
        self._outputs.setdefault(table, []).append((register, channel))
        self._exists(table, register)

    def read(self, table: str, first: int, count: int, now_ns: int) -> list[int] | None:
        """Registers, or coils, from `first` on, as they are now; None where one of them doesn't exist."""
        memory = self._memory.get(table, {})
        if any(address not in memory for address in range(first, first + count)):
            return None
        self._refresh(table, first, count, now_ns)
        return [memory[address] for address in range(first, first + count)]

    def write(self, table: str, first: int, words: Sequence[int]) -> bool:
        """Take registers, or coils, into force; False where one of them doesn't exist or can't be written."""
        memory, outputs = self._memory.get(table, {}), self._outputs.get(table, [])
        touched = range(first, first + len(words))
        writable = {at for register, _ in outputs for at in range(register.address, register.address + register.width)}
        if any(address not in writable for address in touched):
            return False
        memory.update(zip(touched, words, strict=True))
        self._behind.write(
            {
                channel: register.value([memory[register.address + i] for i in range(register.width)])
                for register, channel in outputs
                if register.address < touched.stop and register.address + register.width > first
            }
        )
        return True

    def _exists(self, table: str, register: DeviceRegister) -> None:
        memory = self._memory.setdefault(table, {})
        for address in range(register.address, register.address + register.width):
            memory.setdefault(address, 0)

    def _refresh(self, table: str, first: int, count: int, now_ns: int) -> None:
        """Measure what lies in that part of the table."""
        self._behind.advance_to(now_ns)
        if now_ns >= self.counts_from_ns:
            self._count = now_ns // COUNT_EVERY_NS
        for register, channel in self._measured.get(table, ()):
            if _meets(register, first, count):
                self._put(table, register, register.words(self._behind.read(channel)))
        for register, code in self._constant.get(table, ()):
            if _meets(register, first, count):
                self._put(table, register, register.code_words(code ^ self.is_another))
        for register in self._counters.get(table, ()):
            if _meets(register, first, count):
                counts = int(register.high) + 1 if register.is_bits else register.counts
                self._put(table, register, register.code_words(self._count % counts))

    def _put(self, table: str, register: DeviceRegister, words: Sequence[int]) -> None:
        memory = self._memory[table]
        if register.is_bits:
            memory[register.address] = memory[register.address] & ~register.mask | words[0]
            return
        for i, word in enumerate(words):
            memory[register.address + i] = word


def _meets(register: DeviceRegister, first: int, count: int) -> bool:
    return register.address < first + count and register.address + register.width > first


def unit_of(name: str, keys: Any, behind: Behind) -> ModbusUnit:
    """The unit that a section `units` of the driver's options describes."""
    unit = ModbusUnit(name, behind)
    for task in keys.tasks.values():
        for register in _registers(keys, task.read):
            unit.add_measured(_READ[task.function], register, f"{name}.{register.name}")
        for register in _registers(keys, task.write):
            unit.add_output(_WRITTEN[task.function], register, f"{name}.{register.name}")
        if task.status is not None:
            unit.add_constant(_READ[task.function], DeviceRegister("status", keys, task.status), task.status.good[0])
        if task.counter is not None:
            unit.add_counter(_READ[task.function], DeviceRegister("counter", keys, task.counter))
    for register in _registers(keys, keys.identity):
        entry = keys.identity[register.name]
        unit.add_constant(_READ[entry.function], register, entry.value)
    return unit


def _registers(unit: Any, entries: Mapping[str, Any]) -> Iterator[DeviceRegister]:
    return (DeviceRegister(name, unit, entry) for name, entry in entries.items())
