"""Keys of the driver ``line``: one port, one framing.

One of `serial`, `tcp`, `udp` says where the device is, one of `binary`, `ascii`, `stream` what is spoken.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from micromanip.driver import BusOptions, Section, Watchdog

from .ascii_options import Ascii
from .binary_options import Binary
from .stream_options import Stream

PortNumber = Annotated[int, Field(strict=True, ge=1, le=65_535)]
Settle = Annotated[float, Field(strict=True, ge=0, le=10_000)]
Microseconds = Annotated[float, Field(strict=True, ge=0, le=100_000)]


class Rs485(Section):
    """Two wires for both directions: one sender at a time, which the adapter or the kernel switches by itself."""

    turnaround_us: Microseconds = Field(
        default=0.0, description="Silence between a reception and the next transmission."
    )
    echo: bool = Field(
        default=False, strict=True, description="The port receives its own transmission; the driver removes it."
    )


class SerialPort(Section):
    """A serial line, over a UART, a USB adapter or a pseudo terminal."""

    device: str = Field(min_length=1, description="Device file; /dev/serial/by-id/... is stable.")
    baud: Annotated[int, Field(strict=True, ge=50, le=50_000_000)] = Field(description="Bits per second.")
    bytesize: Literal[5, 6, 7, 8] = Field(default=8, description="Data bits per character.")
    parity: Literal["none", "even", "odd"] = Field(default="none", description="Parity bit.")
    stopbits: Literal[1, 2] = Field(default=1, description="Stop bits per character.")
    low_latency: bool = Field(
        default=True,
        strict=True,
        description="Ask the kernel for every byte at once; a USB adapter otherwise collects them for up to 16 ms. "
        "Ignored by ports that cannot.",
    )
    settle_ms: Settle = Field(
        default=0.0, description="Pause after opening, for a board that is reset by it; nothing is sent meanwhile."
    )
    rs485: Rs485 | None = Field(default=None, description="RS-485; null: RS-232, RS-422 or USB.")

    @property
    def bits_per_byte(self) -> int:
        """Bits that a byte costs on the wire."""
        return 1 + self.bytesize + (self.parity != "none") + self.stopbits


class TcpPort(Section):
    """A TCP connection to the device."""

    host: str = Field(min_length=1, description="Address of the device.")
    port: PortNumber = Field(description="TCP port of the device.")
    settle_ms: Settle = Field(
        default=0.0, description="Pause after opening, for a device that is deaf at first; nothing is sent meanwhile."
    )
    link_Mbit_per_s: float = Field(
        default=100.0, strict=True, gt=0, le=100_000, description="Slowest part of the network."
    )


class UdpPort(Section):
    """UDP datagrams to and from one device; those of others are counted and dropped."""

    host: str = Field(min_length=1, description="Address of the device.")
    port: PortNumber = Field(description="UDP port of the device, for both directions.")
    listen: PortNumber | None = Field(
        default=None,
        description="UDP port of the controller; null: any, and the device answers to it.",
    )
    link_Mbit_per_s: float = Field(
        default=100.0, strict=True, gt=0, le=100_000, description="Slowest part of the network."
    )


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
