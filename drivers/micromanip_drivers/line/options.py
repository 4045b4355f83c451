"""Keys of the driver ``line``: one port, one framing.

Exactly one of `serial`, `tcp`, `udp` says where the device is (``port_options.py``), exactly one of `binary`, `ascii`,
`stream` what is spoken; each has an example at the head of its own file.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from micromanip.driver import BusOptions, Watchdog

from .ascii_options import Ascii
from .binary_options import Binary
from .port_options import SerialPort, TcpPort, UdpPort
from .stream_options import Stream

_PORTS, _FRAMINGS = ("serial", "tcp", "udp"), ("binary", "ascii", "stream")


class LineOptions(BusOptions):
    """A device on a line of its own."""

    serial: SerialPort | None = Field(default=None, description="A serial line.")
    tcp: TcpPort | None = Field(default=None, description="A TCP connection.")
    udp: UdpPort | None = Field(default=None, description="UDP.")
    binary: Binary | None = Field(default=None, description="Frames with sync bytes and checksum.")
    ascii: Ascii | None = Field(default=None, description="Lines of text.")
    stream: Stream | None = Field(default=None, description="Packets of samples, sent by the device unrequested.")
    silence_ms: Annotated[float, Field(strict=True, ge=10, le=2_000)] = Field(
        default=500.0,
        description="Longest time without a valid message of a device that should send; then the link is lost.",
    )
    watchdog: Watchdog | None = Field(default=None, description="What the device does by itself; null: nobody knows.")

    @model_validator(mode="after")
    def _one_of_each(self) -> LineOptions:
        for what, keys in (("port", _PORTS), ("framing", _FRAMINGS)):
            given = [key for key in keys if getattr(self, key) is not None]
            if len(given) != 1:
                found = f"there are {' and '.join(given)}" if given else "there is none"
                raise ValueError(f"give one {what}, {', '.join(keys[:-1])} or {keys[-1]}; {found}")
        return self

    @property
    def port(self) -> SerialPort | TcpPort | UdpPort:
        """Where the device is."""
        port = self.serial or self.tcp or self.udp
        assert port is not None
        return port
