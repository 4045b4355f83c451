r"""A piezo controller that speaks GCS 2.0 as far as its axes are moved in open loop: lines of text that end in \n.

Axes and piezo channels have the same names. A command that is wrong does nothing at all and isn't answered; ``ERR?``
tells its code, and clears it. All lines of an answer but the last end in " \n".
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from micromanip.testbus.event_loop import EventLoop

from .device import Behind, LineDevice
from .device_line import DeviceLine
from .port import Peer

_MAKER = "(c)2015 Physik Instrumente (PI) GmbH & Co. KG"
IDENTITY = f"{_MAKER}, E-727, 0119000001, 13.21.00.09"
WRONG_IDENTITY = f"{_MAKER}, E-709.CHG, 0119000002, 02.012"
UNKNOWN_COMMAND, INVALID_AXIS, OUT_OF_RANGE, WRONG_COUNT, INVALID_NUMBER = 2, 15, 17, 24, 25
_LONGEST = 1024
"""A line that is longer is no line of anybody who knows the protocol."""
_VOLTS = (-30.0, 135.0)
"""What a channel can do whose range the configuration doesn't tell."""
_OTHERS = ("*IDN?", "ERR?", "HLP?", "SAI?", "TPC?", "TSC?")


class GcsRefusal(Exception):  # noqa: N818
    """A command that is not done, with the code that ``ERR?`` tells."""

    def __init__(self, code: int) -> None:
        super().__init__(f"error {code}")
        self.code = code


@dataclass(frozen=True)
class Affine:
    """A channel of the driver, and what its numbers in a text mean: value = scale x number + offset."""

    channel: str
    scale: float
    offset: float

    def number(self, value: float) -> float:
        """On the line."""
        return (value - self.offset) / self.scale

    def value(self, number: float) -> float:
        """In the unit of the channel."""
        return self.scale * number + self.offset


@dataclass
class GcsAxis:
    """An axis with its piezo channel. Numbers are those on the line."""

    behind: Behind
    output: Affine | None = None
    """None where nobody writes it."""
    limits: tuple[float, float] = _VOLTS
    sensors: dict[str, Affine] = field(default_factory=dict)
    """By command, POS? and TSP?; the one that is there answers both."""
    commanded: float = 0.0

    def position(self, command: str) -> float:
        """As its sensor tells it; 0 without one."""
        sensor = self.sensors.get(command) or next(iter(self.sensors.values()), None)
        return sensor.number(self.behind.read(sensor.channel)) if sensor else 0.0

    @property
    def voltage(self) -> float:
        """What its amplifier puts out."""
        return self.output.number(self.behind.voltage_V(self.output.channel)) if self.output else 0.0


_QUERIES: dict[str, Callable[[GcsAxis], float]] = {
    "POS?": lambda axis: axis.position("POS?"),
    "TSP?": lambda axis: axis.position("TSP?"),
    "VOL?": lambda axis: axis.voltage,
    "SVA?": lambda axis: axis.commanded,
}
_HELP = sorted([*_OTHERS, "SVA {<AxisID> <Number>}", *(f"{query} [{{<ItemID>}}]" for query in _QUERIES)])


class GcsController(LineDevice):
    """The commands; lines may end in CR, LF or both."""

    faults = ("identity", "gcs_error")

    def __init__(self, loop: EventLoop, line: DeviceLine, behind: Behind, keys: Any) -> None:
        """`keys` are the driver's, `ascii` with the preset `gcs`."""
        super().__init__(loop, line, behind)
        axes: dict[str, GcsAxis] = {}
        for command, item, affine, given in (*_fields(keys.write), *_fields(keys.read)):
            axis = axes.setdefault(item, GcsAxis(behind))
            if command == "SVA":
                low, high = given.range if "range" in given.model_fields_set else _VOLTS
                low, high = sorted(map(affine.number, (low, high)))
                axis.output, axis.limits = affine, (low, high)
            elif command in ("POS?", "TSP?"):
                axis.sensors[command] = affine
        self._axes = {name: axes[name] for name in sorted(axes)}
        self.signals = [behind.signal(each.channel) for axis in axes.values() for each in axis.sensors.values()]
        self._turnaround_ns, self._error = round(keys.turnaround_us * 1e3), 0
        self._begun: dict[Peer, bytes] = {}

    @property
    def description(self) -> str:
        return f"GCS 2.0 controller, axes {' '.join(self._axes)}"

    def hear(self, data: bytes, peer: Peer) -> None:
        if not data:
            self._begun.pop(peer, None)
            return
        *lines, rest = re.split(rb"[\r\n]", self._begun.get(peer, b"") + data)
        self._begun[peer] = rest[-_LONGEST:]
        for line in filter(bytes.strip, lines):
            self._answer(peer, line.decode("latin-1"))

    def reboot(self, for_s: float) -> None:
        super().reboot(for_s)
        self._error = 0
        for axis in self._axes.values():
            axis.commanded = 0.0
        self._begun.clear()

    def _answer(self, peer: Peer, line: str) -> None:
        self.figures.received += 1
        self._behind.advance_to(self._loop.now_ns())
        try:
            answer = self._done(line).encode("latin-1")
        except GcsRefusal as refusal:
            self._error = refusal.code
            return
        if answer:
            self.figures.sent += 1
            ready_ns = self._loop.now_ns() + self._turnaround_ns
            self._loop.call_at(ready_ns, lambda: self._line.answer(peer, answer))

    def _done(self, line: str) -> str:
        """What comes back for a line, empty for nothing."""
        word, *arguments = line.split() or [""]
        match word.upper():
            case "*IDN?":
                return (WRONG_IDENTITY if self._line.active("identity") else IDENTITY) + "\n"
            case "ERR?":
                error, self._error = self._error, 0
                return f"{error}\n"
            case "HLP?":
                return _lines(["The following commands are valid:", *_HELP, "end of help"])
            case "TPC?" | "TSC?":
                return f"{len(self._axes)}\n"
            case "SAI?":
                return _lines(self._chosen([] if arguments == ["ALL"] else arguments))
            case "SVA":
                self._put(arguments)
                return ""
            case query if query in _QUERIES:
                return _lines(f"{name}={_QUERIES[query](self._axes[name]):.6e}" for name in self._chosen(arguments))
        raise GcsRefusal(UNKNOWN_COMMAND)

    def _put(self, arguments: list[str]) -> None:
        """All of it, or nothing."""
        if fault := self._line.active("gcs_error"):
            raise GcsRefusal(fault.code)
        if not arguments or len(arguments) % 2:
            raise GcsRefusal(WRONG_COUNT)
        axes = [self._axes[name] for name in self._chosen(arguments[::2])]
        wanted = list(zip(axes, map(_parsed, arguments[1::2]), strict=True))
        if not all(axis.limits[0] <= number <= axis.limits[1] for axis, number in wanted):
            raise GcsRefusal(OUT_OF_RANGE)
        for axis, number in wanted:
            axis.commanded = number
        outputs = ((axis.output, number) for axis, number in wanted)
        self._behind.write({output.channel: output.value(number) for output, number in outputs if output})

    def _chosen(self, names: list[str]) -> list[str]:
        """Those that are named; all where none is."""
        if any(name not in self._axes for name in names):
            raise GcsRefusal(INVALID_AXIS)
        return names or list(self._axes)


def _fields(exchanges: Mapping[str, Any]) -> Iterator[tuple[str, str, Affine, Any]]:
    """Command, item on the device, channel and keys of each field."""
    for exchange in exchanges.values():
        for channel, given in exchange.fields.items():
            yield exchange.command or "", given.item or channel, Affine(channel, given.scale, given.offset), given


def _lines(lines: Iterable[str]) -> str:
    return " \n".join(lines) + "\n"


def _parsed(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        raise GcsRefusal(INVALID_NUMBER) from None
    if not math.isfinite(number):
        raise GcsRefusal(INVALID_NUMBER)
    return number
