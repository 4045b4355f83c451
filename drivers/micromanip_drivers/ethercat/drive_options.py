"""Keys of a terminal that is a drive with the profile CiA 402 (IEC 61800-7-201), and the objects that it must map.

drive:
mode: csp
enable: amplifier_enable
ok: amplifier_ok_x
reset: amplifier_reset
enable_ms: 500
stop: quick_stop
take_up_V_per_s: 50
codes: {quick_stop: 2, connection_lost: 3}
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from micromanip.driver import Section
from micromanip_drivers.line.section import Name

Time = Annotated[float, Field(strict=True, ge=1, le=60_000)]
Speed = Annotated[float, Field(strict=True, gt=0, le=1e9)]


@dataclass(frozen=True)
class DriveObject:
    """An object of the profile that the process data must have, subindex 0."""

    index: int
    type: str
    name: str


@dataclass(frozen=True)
class Mode:
    """A mode of operation: its number, its bit in 0x6502, its target, and what says where the drive is."""

    number: int
    supported: int
    target: DriveObject
    actual: DriveObject | None


CONTROLWORD = DriveObject(0x6040, "uint16", "controlword")
STATUSWORD = DriveObject(0x6041, "uint16", "statusword")
ERROR_CODE = DriveObject(0x603F, "uint16", "error code")
MODE = DriveObject(0x6060, "int8", "mode of operation")
MODE_SHOWN = DriveObject(0x6061, "int8", "mode of operation display")
POSITION = DriveObject(0x6064, "int32", "position actual value")
MODES = {
    "csp": Mode(8, 0x080, DriveObject(0x607A, "int32", "target position"), POSITION),
    "csv": Mode(9, 0x100, DriveObject(0x60FF, "int32", "target velocity"), None),
    "cst": Mode(10, 0x200, DriveObject(0x6071, "int16", "target torque"), None),
}


class DriveCodes(Section):
    """Option codes: what the drive does by itself. Written in PREOP and read back; null: the drive keeps its own."""

    connection_lost: Annotated[int, Field(strict=True, ge=1, le=3)] | None = Field(
        default=None, description="0x6007, no frames: 1 fault, 2 disable voltage, 3 quick stop."
    )
    quick_stop: Annotated[int, Field(strict=True, ge=0, le=4)] | None = Field(
        default=None,
        description="0x605A: 0 disable at once, 1 slow-down ramp, 2 quick-stop ramp, 3 current limit, 4 voltage "
        "limit. Not 5 to 8: they stay in Quick stop active, which leaves power on an uncontrolled drive.",
    )
    shutdown: Annotated[int, Field(strict=True, ge=0, le=1)] | None = Field(
        default=None, description="0x605B: 0 disable at once, 1 slow-down ramp."
    )
    disable_operation: Annotated[int, Field(strict=True, ge=0, le=1)] | None = Field(
        default=None, description="0x605C: 0 disable at once, 1 slow-down ramp."
    )
    halt: Annotated[int, Field(strict=True, ge=1, le=4)] | None = Field(
        default=None, description="0x605D: 1 slow-down ramp, 2 quick-stop ramp, 3 current limit, 4 voltage limit."
    )
    fault_reaction: Annotated[int, Field(strict=True, ge=0, le=4)] | None = Field(
        default=None, description="0x605E, as `quick_stop`."
    )

    @property
    def objects(self) -> Mapping[int, int]:
        """Those that are written, by index."""
        indices = {
            0x6007: self.connection_lost,
            0x605A: self.quick_stop,
            0x605B: self.shutdown,
            0x605C: self.disable_operation,
            0x605D: self.halt,
            0x605E: self.fault_reaction,
        }
        return {index: code for index, code in indices.items() if code is not None}


class Drive(Section):
    """The terminal is a drive: what it is given goes through its power state machine."""

    mode: Literal["csp", "csv", "cst"] = Field(
        description="Cyclic synchronous position, velocity or torque; the target is an ordinary output."
    )
    enable: Name = Field(
        description="Channel of the enabling switch, usually `amplifier_enable`; drives may share one."
    )
    ok: Name = Field(
        description="Channel of an input: 1 while the drive is in its demanded state; usually `amplifier_ok_x`."
    )
    reset: Name | None = Field(
        default=None,
        description="Channel of the switch that resets its faults, usually `amplifier_reset`; null: none.",
    )
    enable_ms: Time = Field(
        default=500.0,
        description="Longest time from permission to Operation enabled with the target taken up; afterwards a new "
        "permission is needed. `check` requires less than `start.enable_s`.",
    )
    stop: Literal["disable_voltage", "quick_stop"] = Field(
        default="disable_voltage", description="Command when the permission ends during operation."
    )
    stop_ms: Time = Field(
        default=500.0, description="Longest quick stop; then the voltage is disabled and the drive is not ok."
    )
    take_up_V_per_s: Speed | None = Field(
        default=None,
        description="Speed at which the target moves from the drive's position at enabling to the loop's demand; "
        "required with csp, and only there.",
    )
    codes: DriveCodes = Field(default=DriveCodes(), description="Option codes of the profile.")

    @model_validator(mode="after")
    def _takes_up_positions(self) -> Drive:
        if (self.take_up_V_per_s is not None) != (self.mode == "csp"):
            raise ValueError("take_up_V_per_s: must be given with mode csp, and only there")
        return self

    @model_validator(mode="after")
    def _own_channels(self) -> Drive:
        if self.reset == self.enable:
            raise ValueError("reset: must be another channel than enable")
        return self

    @property
    def channels(self) -> tuple[str, ...]:
        """Of the switches that it goes by."""
        return (self.enable,) if self.reset is None else (self.enable, self.reset)

    @property
    def targets(self) -> DriveObject:
        """What its mode is given."""
        return MODES[self.mode].target

    @property
    def outputs(self) -> tuple[DriveObject, ...]:
        """What it must receive."""
        return CONTROLWORD, MODE, self.targets

    @property
    def inputs(self) -> tuple[DriveObject, ...]:
        """What it must send."""
        actual = MODES[self.mode].actual
        return (STATUSWORD, MODE_SHOWN, ERROR_CODE, *(() if actual is None else (actual,)))


def require_objects(drive: Drive, outputs: Mapping[str, Any], inputs: Mapping[str, Any]) -> None:
    """Raises ValueError where the PDOs of a terminal do not map what its drive needs."""
    for direction, pdos, wanted in (("outputs", outputs, drive.outputs), ("inputs", inputs, drive.inputs)):
        for each in wanted:
            found = list(fields_of(pdos, each))
            if [field.type for _, field in found] != [each.type]:
                raise ValueError(
                    f"drive: {direction} must map 0x{each.index:04x}:00, {each.name}, once and as {each.type}"
                )
    for pdo in inputs.values():
        if pdo.counter is not None and any(field.index == STATUSWORD.index for field in pdo.fields.values()):
            raise ValueError("drive: the PDO of the statusword has a counter: it must be fresh in each cycle")


def fields_of(pdos: Mapping[str, Any], wanted: DriveObject) -> Iterator[tuple[str, Any]]:
    """Name and keys of the fields that are this object."""
    for pdo in pdos.values():
        for name, field in pdo.fields.items():
            if (field.index, field.subindex) == (wanted.index, 0):
                yield name, field


def words_of(drive: Drive | None, outputs: Mapping[str, Any]) -> set[str]:
    """Fields of a terminal's outputs that are no channels: the driver itself fills them."""
    if drive is None:
        return set()
    return {name for each in (CONTROLWORD, MODE) for name, _ in fields_of(outputs, each)}
