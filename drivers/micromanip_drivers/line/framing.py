"""What a framing does for the driver: channels, and their values on the port; silence; how long bytes keep the line."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from micromanip.driver import Answer, Channel, Inbox, LinkError, Load, Outcome, Steady, Task

from .options import SerialPort, TcpPort, UdpPort


class Framing(ABC):
    """One device on one port; the port is open when a method is called."""

    inputs: Sequence[Channel]
    outputs: Sequence[Channel]
    tasks: Sequence[Task]
    loads: Sequence[Load]
    speaks_hz: float | None = None
    """How often the device speaks by itself, at least; None for one that only answers."""

    @abstractmethod
    def begin(self, deadline_ns: int) -> None:
        """The port was opened just now: forget what was, look who answers, until `deadline_ns` at the latest.

        Raises LinkError where nobody answers, IdentityMismatch for another device than the one configured.
        """

    def end(self) -> None:  # noqa: B027 (most hold nothing)
        """The port is about to be closed; does no harm twice."""

    @abstractmethod
    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> Outcome | None:
        """As ``BusDriver.perform``."""

    def read_outputs(self) -> Sequence[float | None]:
        """As ``BusDriver.read_outputs``."""
        return [None] * len(self.outputs)

    @abstractmethod
    def receive(self, inbox: Inbox, until_ns: int) -> None:
        """As ``BusDriver.receive``."""

    def steady(self) -> Steady | None:
        """As ``BusDriver.steady``."""
        return None

    @abstractmethod
    def probe(self, seconds: float) -> Iterator[Answer]:
        """What answers, and what it says; nothing is moved."""

    @property
    @abstractmethod
    def counters(self) -> Mapping[str, int]:
        """Of its own, since it was built; they only rise."""


class Silence:
    """Watches for `limit_ms` without anything that was understood, while something is expected.

    A device that should speak and doesn't: a half-open connection, a cable that was pulled, a device that hangs.
    """

    def __init__(self, name: str, limit_ms: float) -> None:
        self._name = name
        self._limit_ns = round(limit_ms * 1e6)
        self._since_ns: int | None = None
        self._line = ""

    def misunderstood(self, line: str) -> None:
        """A line that came; it is told where nothing better does."""
        self._line = line

    @property
    def limit_ns(self) -> int:
        """So long it may be silent."""
        return self._limit_ns

    @property
    def since_ns(self) -> int:
        """When it was understood last, or should have begun to speak; 0 while nothing is expected."""
        return self._since_ns or 0

    def expect(self, now_ns: int) -> None:
        """From now on it should speak, if it should not already."""
        if self._since_ns is None:
            self._since_ns = now_ns

    def heard(self, now_ns: int, more: bool) -> None:
        """It was understood; `more`: and should speak again without being asked."""
        self._since_ns = now_ns if more else None
        self._line = ""

    def check(self, now_ns: int) -> None:
        """Raises LinkError when it has been silent for too long."""
        if self._since_ns is not None and now_ns - self._since_ns > self._limit_ns:
            came = f'; what came: "{self._line}"' if self._line else ""
            raise LinkError(f"{self._name}: nothing understood for {self._limit_ns * 1e-6:g} ms{came}")


_ETHERNET_BYTES, _SHORTEST, _LONGEST = 38, 84, 1538
"""Preamble, header, check sequence and gap; the shortest and the longest packet, with these."""
_IP_BYTES, _TCP_BYTES, _UDP_BYTES = 20, 32, 8


@dataclass(frozen=True)
class Traffic:
    """Something that goes over the line again and again."""

    what: str
    rate_hz: float
    seconds: float
    direction: Literal["in", "out", "both"]
    """both: an exchange, during which nothing else can be done."""


class LineTime:
    """Of the port that `options` name."""

    def __init__(self, options: SerialPort | TcpPort | UdpPort) -> None:
        self._options = options

    def seconds(self, count: int) -> float:
        """How long `count` bytes that are sent together take, at worst: each TCP segment is acknowledged."""
        options = self._options
        if isinstance(options, SerialPort):
            return count * options.bits_per_byte / options.baud
        headers = _ETHERNET_BYTES + _IP_BYTES + (_TCP_BYTES if isinstance(options, TcpPort) else _UDP_BYTES)
        packets = max(1, -(-count // (_LONGEST - headers)))
        on_wire = max(_SHORTEST * packets, count + packets * headers)
        if isinstance(options, TcpPort):
            on_wire += packets * _SHORTEST
        return on_wire * 8 / (options.link_Mbit_per_s * 1e6)

    @property
    def turnaround_s(self) -> float:
        """Silence that we keep before we speak."""
        rs485 = self._options.rs485 if isinstance(self._options, SerialPort) else None
        return rs485.turnaround_us * 1e-6 if rs485 else 0.0

    @property
    def _name(self) -> str:
        if isinstance(self._options, SerialPort):
            return Path(self._options.device).name
        return f"link {self._options.host}"

    @property
    def _is_shared(self) -> bool:
        return isinstance(self._options, SerialPort) and self._options.rs485 is not None

    def loads(self, traffic: Sequence[Traffic]) -> list[Load]:
        """Of each direction by itself, where the line has two and nobody waits for an answer; else of both together."""
        if self._is_shared or any(one.direction == "both" for one in traffic):
            return [_load(self._name, traffic)]
        directions = {one.direction for one in traffic}
        return [
            _load(f"{self._name} {direction}", [one for one in traffic if one.direction == direction])
            for direction in sorted(directions)
        ]


def _load(name: str, traffic: Sequence[Traffic]) -> Load:
    detail = " + ".join(f"{one.rate_hz:g} {one.what} x {one.seconds * 1e6:.0f} us" for one in traffic)
    return Load(name, sum(one.rate_hz * one.seconds for one in traffic), detail)
