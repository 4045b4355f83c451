"""Keys of the driver `modbus` (``docs/modbus.md``); channels are called unit.register: "gauge.strain_x".

Nothing of a register is guessed: `device probe` shows each one under every order.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from micromanip.driver import BusOptions, Section, Watchdog

from ..line.port_options import SerialPort, TcpPort
from ..line.section import Name
from .task_options import Task

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

    @property
    def drain_s(self) -> float:
        """How long a serial line must have been silent after a time-out."""
        return 1e-3 * (3.0 * self.timeout_ms if self.drain_ms is None else self.drain_ms)
