"""Keys of the driver `modbus` (``docs/modbus.md``); channels are called unit.register: "gauge.strain_x".

Nothing of a register is guessed: `device probe` shows each one under every order.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from micromanip.driver import BusOptions, Commanded, Scaled, Section, Watchdog, number_range
from micromanip.driver.quantities import Latency, SampleRate

from ..line.frame_options import Name
from ..line.options import SerialPort, TcpPort

READS = {1: "coils", 2: "discrete inputs", 3: "holding registers", 4: "input registers", 23: "holding registers"}
WRITES = {5: "coils", 6: "holding registers", 15: "coils", 16: "holding registers", 23: "holding registers"}
"""Function codes that there are, and the table that each one reads or writes."""
READ_BACK = {"coils": 1, "holding registers": 3}
"""Function that reads what a function writes."""
BIT_TABLES = ("coils", "discrete inputs")
REGISTERS = {
    **dict.fromkeys(("bits", "int16", "uint16", "coil"), 1),
    **dict.fromkeys(("int32", "uint32", "float32"), 2),
    **dict.fromkeys(("int64", "uint64", "float64"), 4),
}
"""How many registers a type takes, or how many coils."""
UNSIGNED = ("bits", "uint16", "uint32", "uint64", "coil")

Type = Literal["int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64", "bits", "coil"]
Function = Literal[1, 2, 3, 4, 5, 6, 15, 16, 23]
Whole = Annotated[int, Field(strict=True, ge=0)]


class Register(Section):
    """A number in the device: one register or several, some bits of one, or a coil."""

    address: Annotated[int, Field(strict=True, ge=0, le=0x20000)] = Field(
        description="Number in the manual of the first register, see address_base."
    )
    type: Type = Field(description="Type of the number; bits are those of a register.")
    first_bit: Annotated[int, Field(strict=True, ge=0, le=15)] | None = Field(
        default=None, description="Type bits: lowest bit, from 0."
    )
    bit_count: Annotated[int, Field(strict=True, ge=1, le=16)] = Field(
        default=1, description="Type bits: number of bits."
    )

    @model_validator(mode="after")
    def _bits_are_named(self) -> Register:
        if (self.type == "bits") != (self.first_bit is not None):
            raise ValueError("first_bit goes with type: bits, and type: bits with first_bit")
        if self.type != "bits" and self.bit_count != 1:
            raise ValueError("bit_count goes with type: bits")
        if self.first_bit is not None and self.first_bit + self.bit_count > 16:
            raise ValueError(f"bit_count: a register has 16 bits, not {self.first_bit + self.bit_count}")
        return self

    @property
    def count(self) -> int:
        """How many registers, or coils, it takes."""
        return REGISTERS[self.type]

    @property
    def mask(self) -> int:
        """Its bits in the register, for type bits."""
        return ((1 << self.bit_count) - 1) << (self.first_bit or 0)


def code_range(register: Register) -> tuple[float, float]:
    """Lowest and highest number that it holds."""
    if register.type in ("bits", "coil"):
        return 0.0, (1 << register.bit_count) - 1.0
    return number_range(register.type)


class Input(Scaled, Register):
    """A value from the device."""

    latency_us: Latency = Field(
        default=0.0,
        description="Age of a reading in the device when it is requested; of an output, time until it acts.",
    )


class Output(Commanded, Input):
    """A value to the device, written repeatedly."""

    cyclic_safe: bool = Field(
        default=False,
        strict=True,
        description="The manual allows endless writing of this register. Flash memory, where many registers are, "
        "wears out after some 10,000 writes: seconds.",
    )

    @property
    def numbers(self) -> tuple[float, float]:
        return code_range(self)

    @model_validator(mode="after")
    def _may_be_written(self) -> Output:
        if not self.cyclic_safe:
            raise ValueError(
                "cyclic_safe: this register would be written at the task's rate, and is not marked safe for that: many "
                "registers are flash memory that is worn out after 10,000 writes; if the device's manual allows it, "
                "write cyclic_safe: true"
            )
        return self


class Counter(Register):
    """A number that the device changes with each measurement: the same number is not fresh."""

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if self.type not in UNSIGNED:
            raise ValueError(f"type: one of {', '.join(UNSIGNED)} is needed, not {self.type}")
        return self


class Status(Counter):
    """A number that marks the device's values as valid."""

    good: tuple[Whole, ...] = Field(default=(0,), min_length=1, description="Good values.")


class Task(Section):
    """Transactions at one rate; consecutive registers share a transaction."""

    function: Function = Field(
        description="1 and 2 read coils and discrete inputs, 3 and 4 holding and input registers; 5 and 15 write "
        "coils, 6 and 16 registers, singly or together; 23 writes and reads in one transaction."
    )
    rate_hz: SampleRate = Field(description="Rate of the task.")
    read: dict[Name, Input] = Field(default={}, description="Values to read, by name.")
    write: dict[Name, Output] = Field(default={}, description="Values to write, by name.")
    status: Status | None = Field(default=None, description="Marks the other values as valid.")
    counter: Counter | None = Field(default=None, description="Marks the other values as fresh.")

    @model_validator(mode="after")
    def _function_fits(self) -> Task:
        reads, writes = self.function in READS, self.function in WRITES
        for key, wanted, there in (("read", reads, self.read), ("write", writes, self.write)):
            if wanted and not there:
                raise ValueError(f"{key}: function {self.function} needs registers to {key}")
            if there and not wanted:
                raise ValueError(f"{key}: function {self.function} can't {key}: choose another, or leave this out")
        if not reads and (self.status or self.counter):
            raise ValueError(f"function {self.function} reads nothing, so there is no status and no counter")
        return self

    @model_validator(mode="after")
    def _types_fit(self) -> Task:
        own = {key: one for key, one in (("status", self.status), ("counter", self.counter)) if one}
        for place, register in {**_below("read", self.read), **_below("write", self.write), **own}.items():
            table = WRITES[self.function] if place.startswith("write") else READS[self.function]
            if (table in BIT_TABLES) != (register.type == "coil"):
                fits = "coil" if table in BIT_TABLES else "int16, float32, bits, ... and not coil"
                raise ValueError(f"{place}.type: function {self.function} is for {table}, whose type is {fits}")
            if self.function == 6 and register.count > 1:
                raise ValueError(
                    f"{place}.type: function 6 writes one register, {register.type} takes {register.count}"
                )
        return self


def _below(key: str, registers: Mapping[str, Register]) -> dict[str, Register]:
    return {f"{key}.{name}": register for name, register in registers.items()}


LARGEST_TIMEOUT_MS = 90.0
"""A worker that does not return from its bus for longer than 100 ms counts as silent."""
RTU_UNITS = range(1, 248)

Order = Literal["big", "little"]
Milliseconds = Annotated[float, Field(strict=True, gt=0, le=LARGEST_TIMEOUT_MS)]


class Expected(Section):
    """A register that identifies the device: a type, a serial number."""

    function: Literal[3, 4] = Field(description="Function code of the read.")
    address: Annotated[int, Field(strict=True, ge=0, le=0x20000)] = Field(description="Number in the manual.")
    type: Literal["uint16", "int16", "uint32", "int32"] = Field(description="Type of the number.")
    value: Annotated[int, Field(strict=True)] = Field(description="Expected value; any other is the wrong device.")


class Unit(Section):
    """A device on the line or behind the gateway."""

    unit_id: Annotated[int, Field(strict=True, ge=0, le=255)] = Field(description="Number of the device on the line.")
    address_base: Annotated[int, Field(strict=True, ge=0, le=0x10000)] = Field(
        description="Number in the manual of the register with address 0 on the wire: 0, 1, 30001, 40001, ..."
    )
    byte_order: Order = Field(description="Byte order in a register: big is the standard.")
    word_order: Order = Field(description="Order of the registers of one number: big has the highest word first.")
    identity: dict[Name, Expected] = Field(
        default={}, description="Registers compared at the start; another device is refused."
    )
    tasks: dict[Name, Task] = Field(min_length=1, description="Reads and writes, each at its rate.")


class ModbusOptions(BusOptions):
    """A line and its devices."""

    tcp: TcpPort | None = Field(default=None, description="Modbus TCP to a device or gateway.")
    serial: SerialPort | None = Field(default=None, description="Modbus RTU on a serial line.")
    timeout_ms: Milliseconds = Field(
        description="Longest time from a request to its complete answer. There are no retries; the task's next turn "
        "sends newer values."
    )
    response_ms: Annotated[float, Field(strict=True, ge=0, le=LARGEST_TIMEOUT_MS)] = Field(
        description="Longest time from a request's end to its answer's beginning, for the budget and the age of values."
    )
    drain_ms: Annotated[float, Field(strict=True, gt=0, le=700)] | None = Field(
        default=None,
        description="Silence required on a serial line after a time-out; longer than any device's latest answer, "
        "which would pass for the next request's. null: three times timeout_ms.",
    )
    watchdog: Watchdog | None = Field(default=None, description="What the device does by itself; null: nobody knows.")
    units: dict[Name, Unit] = Field(min_length=1, description="Devices by name.")

    @model_validator(mode="after")
    def _has_one_port(self) -> ModbusOptions:
        if (self.tcp is None) == (self.serial is None):
            which = "neither is" if self.tcp is None else "both are"
            raise ValueError(
                "exactly one of tcp: {host: ..., port: 502} and serial: {device: ..., baud: ...} must be given, "
                f"and {which} there"
            )
        if self.serial is not None and self.serial.bytesize != 8:
            raise ValueError(f"serial.bytesize: Modbus RTU has 8 data bits, not {self.serial.bytesize}")
        return self

    @model_validator(mode="after")
    def _units_differ(self) -> ModbusOptions:
        taken: dict[int, str] = {}
        for name, unit in self.units.items():
            if self.serial is not None and unit.unit_id not in RTU_UNITS:
                raise ValueError(f"units.{name}.unit_id: on a serial line units go from 1 to 247, not {unit.unit_id}")
            if unit.unit_id in taken:
                raise ValueError(f"units.{name}.unit_id: {unit.unit_id} is also that of {taken[unit.unit_id]}")
            taken[unit.unit_id] = name
        return self

    @property
    def device(self) -> str:
        """The port by name, e.g. "tcp 192.168.0.20:502" or "/dev/ttyUSB0"."""
        return self.serial.device if self.serial else f"tcp {self.tcp.host}:{self.tcp.port}" if self.tcp else ""
