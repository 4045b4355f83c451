"""How long bytes keep the line, or the network on the way: for latencies, and for the budget that ``check`` prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from micromanip.driver import Load

from .options import SerialPort, TcpPort, UdpPort

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
