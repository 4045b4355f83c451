"""Keys of the driver ``ethercat``: the terminals of a line, in their order from the master, and what they exchange.

``config/ethercat.yaml`` and ``docs/ethercat.md`` have examples. Fields stand in the order of the PDO's mapping;
channels have their names.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator, model_validator

from micromanip.driver import BITS, PACKED, Scaled, Section, Typed, Written, did_you_mean, number_range
from micromanip.driver.quantities import Latency, SampleRate
from micromanip.driver.wire import LoopOutput, LoopWireOptions
from micromanip_drivers.line.frame_options import Name, Whole

from .records import MOST_TERMINALS

Number32 = Annotated[int, Field(strict=True, ge=0, le=0xFFFF_FFFF)]
Interface = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,15}$")]
Index = Annotated[int, Field(strict=True, ge=0, le=0xFFFF)]
Subindex = Annotated[int, Field(strict=True, ge=0, le=0xFF)]


class Object(Section):
    """An entry of a terminal's object dictionary; EtherCAT's byte order is little."""

    index: Index = Field(description="Index of the object; in a PDO 0 is a gap of unused bits without a channel.")
    subindex: Subindex = Field(default=0, description="Subindex of the entry.")


class Setting(Object, Typed):
    """An object written before the terminal operates."""

    value: Whole = Field(description="Value; whole numbers only.")

    @model_validator(mode="after")
    def _fits(self) -> Setting:
        if self.type.startswith("float"):
            raise ValueError("a setting is a whole number")
        try:
            self.data  # noqa: B018 (it is computed)
        except OverflowError:
            raise ValueError(f"{self.value} does not fit into {self.type}") from None
        return self

    @property
    def data(self) -> bytes:
        """As it is written."""
        return self.value.to_bytes(self.size, "little", signed=self.type.startswith("int"))


class Entry(Scaled, Object):
    """A number in a PDO."""

    type: str = Field(description=f"One of {', '.join(BITS)}; `bool` is a single bit, 1 is on.")
    spare: bool = Field(
        default=False,
        strict=True,
        description="Unused: no channel; an output stays at `safe`.",
    )

    @field_validator("type")
    @classmethod
    def _is_known(cls, kind: str) -> str:
        if kind not in BITS:
            raise ValueError(f"there is no type {kind}; {did_you_mean(kind, BITS, 'there are')}")
        return kind

    @property
    def bits(self) -> int:
        """How many it has."""
        return BITS[self.type]

    @property
    def mapping(self) -> int:
        """As a PDO's mapping holds it."""
        return self.index << 16 | self.subindex << 8 | self.bits

    @property
    def is_channel(self) -> bool:
        """Whether the loop has anything to do with it."""
        return self.index != 0 and not self.spare


class Input(Entry):
    """A value from a terminal."""


class Output(LoopOutput, Entry):
    """A value to a terminal."""

    @property
    def numbers(self) -> tuple[float, float]:
        return number_range(self.type)


class OutputPdo(Section):
    """A PDO to the terminal."""

    pdo: Index = Field(description="Index, from 0x1600.")
    fields: dict[Name, Output] = Field(min_length=1, description="Mapped objects, in their order.")


class InputPdo(Section):
    """A PDO from the terminal."""

    pdo: Index = Field(description="Index, from 0x1a00.")
    counter: Name | None = Field(
        default=None,
        description="Field that the terminal increments with each sample; null: a new sample in each cycle.",
    )
    rate_hz: SampleRate | None = Field(default=None, description="Sample rate; required with `counter`.")
    latency_us: Latency = Field(default=0.0, description="From sampling until the value is in the terminal's memory.")
    fields: dict[Name, Input] = Field(min_length=1, description="Mapped objects, in their order.")

    @model_validator(mode="after")
    def _counter_is_a_field(self) -> InputPdo:
        if (self.counter is None) != (self.rate_hz is None):
            raise ValueError("counter and rate_hz belong together: give both, or none")
        if self.counter is not None:
            if self.counter not in self.fields:
                raise ValueError(
                    f"counter: there is no field {self.counter}; {did_you_mean(self.counter, self.fields, 'there are')}"
                )
            if not self.fields[self.counter].type.startswith(("uint", "b")):
                raise ValueError("counter: its field must be of a type uint8 to uint64, or of bits")
            if not self.fields[self.counter].is_channel:
                raise ValueError("counter: its field must be no gap, and not spare")
        return self


class Terminal(Section):
    """A terminal at its place in the line."""

    vendor: Number32 = Field(description="Vendor in its EEPROM.")
    product: Number32 = Field(description="Product code.")
    revision: Number32 | None = Field(default=None, description="Revision number; null: any.")
    esi: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="ESI file, relative to the configuration; it must agree with these keys.",
    )
    serial: Number32 | None = Field(default=None, description="Serial number; null: any.")
    sync0_shift_us: Annotated[float, Field(strict=True, ge=0, le=100_000)] | None = Field(
        default=None,
        description="Time of SYNC0 after each deadline of the loop, less than a cycle; requires `lock`. null: none.",
    )
    settings: dict[Name, Setting] = Field(default={}, description="Objects written by SDO in PREOP, in this order.")
    outputs: dict[Name, OutputPdo] = Field(default={}, description="PDOs to the terminal, in the order of 0x1c12.")
    inputs: dict[Name, InputPdo] = Field(default={}, description="PDOs from the terminal, in the order of 0x1c13.")

    @model_validator(mode="after")
    def _lines_are_off_when_safe(self) -> Terminal:
        for pdo_name, pdo in self.outputs.items():
            for name, field in pdo.fields.items():
                is_on = round((field.safe - field.offset) / field.scale) != 0
                if field.type in PACKED and is_on and not self.settings:
                    raise ValueError(
                        f"outputs.{pdo_name}.fields.{name}: safe {field.safe:g} is a line that is on, and a terminal "
                        "without frames switches it off: wire it the other way round and say scale: -1, offset: 1, "
                        "or have the terminal hold it by an object of its own under settings"
                    )
        return self


class Lock(Section):
    """Locks the loop's deadlines to the first terminal's clock."""

    time_constant_ms: Annotated[float, Field(strict=True, ge=1, le=10_000)] = Field(
        default=100.0, description="Both poles of the control law of the deadlines."
    )
    within_us: Annotated[float, Field(strict=True, gt=0, le=1000)] = Field(
        default=10.0,
        description="Largest deviation over a time constant for lock; the outputs rest until then. A larger one for "
        "`silence_ms` is a lost link.",
    )
    drift_ppm: Annotated[float, Field(strict=True, gt=0, le=1000)] = Field(
        default=200.0, description="Largest drift against this machine's clock; a larger one is not followed."
    )


class EthercatOptions(LoopWireOptions, Written):
    """A line of terminals."""

    interface: Interface = Field(description="Network interface, for this line only.")
    return_interface: Interface | None = Field(
        default=None,
        description="Second interface, at the last terminal: a broken cable is survived. null: none.",
    )
    clocks: bool = Field(
        default=True,
        strict=True,
        description="Distributed clocks: all terminals follow the first one's clock, which times the samples. The "
        "first terminal must have one; in a ring every terminal must.",
    )
    lock: Lock | None = Field(
        default=None,
        description="Locks the loop's deadlines to the first terminal's clock, requires `clocks`; null: this "
        "machine's clock.",
    )
    terminals: dict[Name, Terminal] = Field(
        min_length=1, max_length=MOST_TERMINALS, description="Terminals in their order from the master."
    )

    @model_validator(mode="after")
    def _clock_to_lock_to(self) -> EthercatOptions:
        if self.lock is not None and not self.clocks:
            raise ValueError("lock: needs clocks: true, by which the first terminal's clock is read")
        for name, terminal in self.terminals.items():
            if terminal.sync0_shift_us is not None and self.lock is None:
                raise ValueError(f"terminals.{name}.sync0_shift_us: needs lock, or SYNC0 would drift through the cycle")
        return self

    @model_validator(mode="after")
    def _ring(self) -> EthercatOptions:
        if self.return_interface == self.interface:
            raise ValueError("return_interface: must be another one than interface")
        return self

    @property
    def interfaces(self) -> tuple[str, ...]:
        """The one at which the line begins, and the one to which it leads back, if any."""
        return (self.interface,) if self.return_interface is None else (self.interface, self.return_interface)

    @property
    def outputs(self) -> dict[str, Output]:
        """All of them, by name, in the order of the process image."""
        found: dict[str, Output] = {}
        for terminal in self.terminals.values():
            for pdo in terminal.outputs.values():
                found |= {name: each for name, each in pdo.fields.items() if each.is_channel}
        return found
