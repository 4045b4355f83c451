r"""A piezo controller that speaks GCS 2.0: lines of text that end in \n, and a few commands of one byte.

Axes and piezo channels have the same names. An axis is moved in open loop by ``SVA``; after ``SVO`` its own slow servo
follows ``MOV``. A command that is wrong does nothing at all and isn't answered; ``ERR?`` tells its code, and clears it.
All lines of an answer but the last end in " \n".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from .device import Behind
from .device_line import DeviceLine
from .fault import LineFault
from .faults import GcsError, Identity
from .gcs_axis import (
    INVALID_AXIS,
    INVALID_NUMBER,
    OUT_OF_RANGE,
    STOPPED,
    UNKNOWN_COMMAND,
    UNKNOWN_PARAMETER,
    WRONG_COUNT,
    GcsAxis,
    GcsRefusal,
)

_MAKER = "(c)2015 Physik Instrumente (PI) GmbH & Co. KG"
IDENTITY = f"{_MAKER}, E-727, 0119000001, 13.21.00.09"
WRONG_IDENTITY = f"{_MAKER}, E-709.CHG, 0119000002, 02.012"
_UNIT = 0x07000601
"""The only parameter that is known: the unit of an axis."""
_QUERIES: dict[str, Callable[[GcsAxis], str]] = {
    "POS?": lambda axis: _number(axis.position),
    "TSP?": lambda axis: _number(axis.sensor_position),
    "VOL?": lambda axis: _number(axis.voltage),
    "SVA?": lambda axis: _number(axis.commanded),
    "MOV?": lambda axis: _number(axis.target),
    "SVO?": lambda axis: str(int(axis.servo)),
    "ONT?": lambda axis: str(int(axis.on_target)),
    "OVF?": lambda axis: str(int(axis.commanded in axis.limits)),
    "VMI?": lambda axis: _number(axis.limits[0]),
    "VMA?": lambda axis: _number(axis.limits[1]),
}
_COMMANDS = ("SVA", "SVR", "MOV", "SVO")
_OTHERS = (
    "*IDN?",
    "CSV?",
    "ERR?",
    "HLP?",
    "HLT",
    "HPA?",
    "SAI?",
    "SPA?",
    "STP",
    "TPC?",
    "TSC?",
    "VER?",
    "#5",
    "#7",
    "#24",
)


class GcsController:
    """The commands; what moves and measures is behind it."""

    faults: tuple[type[LineFault], ...] = (Identity, GcsError)
    single_bytes = b"\x05\x07\x18"

    def __init__(self, axes: list[GcsAxis], behind: Behind, line: DeviceLine) -> None:
        self.signals = [behind.signal(sensor.channel) for axis in axes for sensor in axis.sensors.values()]
        self.description = f"GCS 2.0 controller, axes {' '.join(axis.name for axis in axes)}"
        self._axes = {axis.name: axis for axis in axes}
        self._behind, self._line, self._error = behind, line, 0

    def answer(self, line: str) -> str:
        try:
            return self._done(line)
        except GcsRefusal as refusal:
            self._error = refusal.code
            return ""

    def step(self) -> None:
        """The servos that are on do their step."""
        moving = [axis for axis in self._axes.values() if axis.servo]
        for axis in moving:
            axis.servo_step()
        self._put(moving)

    def reboot(self) -> None:
        self._error = 0
        for axis in self._axes.values():
            axis.reboot()

    def _done(self, line: str) -> str:
        word, *arguments = line.split() or [""]
        match word.upper():
            case "\x05":
                return "0\n"
            case "\x07":
                return "\xb1\n"
            case "\x18" | "STP" | "HLT":
                return self._stop()
            case "*IDN?":
                return f"{WRONG_IDENTITY if self._line.active(Identity) else IDENTITY}\n"
            case "ERR?":
                error, self._error = self._error, 0
                return f"{error}\n"
            case "CSV?":
                return "2.0\n"
            case "VER?":
                return _lines(["FW_DSP: V13.21.00.09", "HW: simulated"])
            case "HLP?":
                return _lines(["The following commands are valid:", *_help(), "end of help"])
            case "HPA?":
                return _lines(
                    ["The following parameters are valid:", f"0x{_UNIT:X}=\t0\t1\tCHAR\taxis\tUnit", "end of help"]
                )
            case "TPC?" | "TSC?":
                return f"{len(self._axes)}\n"
            case "SAI?":
                return _lines([axis.name for axis in self._chosen([] if arguments == ["ALL"] else arguments)])
            case "SPA?":
                return self._unit(arguments)
            case query if query in _QUERIES:
                return _lines([f"{axis.name}={_QUERIES[query](axis)}" for axis in self._chosen(arguments)])
            case command if command in _COMMANDS:
                self._do(command, arguments)
                return ""
        raise GcsRefusal(UNKNOWN_COMMAND)

    def _do(self, command: str, arguments: list[str]) -> None:
        """All of it, or nothing."""
        if fault := self._line.active(GcsError):
            raise GcsRefusal(fault.code)
        if not arguments or len(arguments) % 2:
            raise GcsRefusal(WRONG_COUNT)
        axes, numbers = self._chosen(arguments[::2]), [_parsed(text) for text in arguments[1::2]]
        if command == "SVR":
            numbers = [axis.commanded + number for axis, number in zip(axes, numbers, strict=True)]
        wanted = list(zip(axes, numbers, strict=True))
        for axis, number in wanted:
            if command in ("SVA", "SVR"):
                axis.check_open_loop(number)
            elif command == "MOV":
                axis.check_target()
            elif number not in (0.0, 1.0):
                raise GcsRefusal(OUT_OF_RANGE)
        for axis, number in wanted:
            if command == "MOV":
                axis.target = number
            elif command == "SVO":
                axis.switch_servo(bool(number))
            else:
                axis.commanded = number
        if command in ("SVA", "SVR"):
            self._put(axes)

    def _put(self, axes: Iterable[GcsAxis]) -> None:
        self._behind.write({axis.output.channel: axis.output.value(axis.commanded) for axis in axes if axis.output})

    def _stop(self) -> str:
        """Axes stay where they are. That is told as error 10, as the standard has it."""
        for axis in self._axes.values():
            axis.target = axis.position
        raise GcsRefusal(STOPPED)

    def _unit(self, arguments: list[str]) -> str:
        if len(arguments) != 2 or _parameter(arguments[1]) != _UNIT:
            raise GcsRefusal(UNKNOWN_PARAMETER)
        (axis,) = self._chosen(arguments[:1])
        return f"{axis.name} 0x{_UNIT:X}=UM\n"

    def _chosen(self, names: list[str]) -> list[GcsAxis]:
        """Those that are named; all where none is."""
        if any(name not in self._axes for name in names):
            raise GcsRefusal(INVALID_AXIS)
        return [self._axes[name] for name in names or self._axes]


def _lines(lines: list[str]) -> str:
    return " \n".join(lines) + "\n"


def _help() -> list[str]:
    queries = dict.fromkeys(_QUERIES, "[{<ItemID>}]")
    commands = dict.fromkeys(_COMMANDS, "{<AxisID> <Number>}")
    return [" ".join(entry).strip() for entry in sorted({**dict.fromkeys(_OTHERS, ""), **queries, **commands}.items())]


def _number(number: float) -> str:
    return f"{number:.6e}"


def _parsed(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        raise GcsRefusal(INVALID_NUMBER) from None
    if not math.isfinite(number):
        raise GcsRefusal(INVALID_NUMBER)
    return number


def _parameter(text: str) -> int | None:
    try:
        return int(text, 0)
    except ValueError:
        return None
