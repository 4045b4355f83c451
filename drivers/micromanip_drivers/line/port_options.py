"""Keys that say which port: a serial line, a TCP connection, or UDP datagrams."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from micromanip.driver import Section

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
