"""Keys of the framing ``stream``: packets with a header, a counter and blocks of samples, that come by themselves.

A capacitive sensor with three channels, over TCP (all numbers little-endian, as its manual says):

    drivers:
      gap:
        driver: line
        tcp: {host: 192.168.0.30, port: 10001}
        silence_ms: 100
        stream:
          magic: 4d 45 41 53                            # "MEAS"
          header_bytes: 32
          identity: {serial_number: {at: 8, type: int32, byte_order: little, value: 4711}}
          status: {at: 20, type: uint32, byte_order: little, good: [0]}
          blocks: {at: 24, type: uint16, byte_order: little, most: 8}   # samples in this packet
          counter: {at: 28, type: uint32, byte_order: little, counts: samples}
          rate_hz: 4000                                 # samples per second
          block_bytes: 12
          fields:                                       # places in the block
            strain_x: {at: 0, type: int32, byte_order: little, scale: 5.96e-6}
            strain_y: {at: 4, type: int32, byte_order: little, scale: 5.96e-6}
            strain_z: {at: 8, type: int32, byte_order: little, scale: 5.96e-6}

A laser tracker, over UDP, one sample per datagram, with its own time stamps:

    drivers:
      tracker:
        driver: line
        udp: {host: 192.168.0.40, port: 5000, listen: 7000}
        silence_ms: 100
        stream:
          magic: 4c 54
          header_bytes: 16
          counter: {at: 4, type: uint32, byte_order: big, counts: packets}
          time: {at: 8, type: uint64, byte_order: big, unit_s: 1.0e-6}
          rate_hz: 1000
          block_bytes: 24
          crc: {name: crc32.iso_hdlc, byte_order: big}  # behind the last block
          fields:
            stage_x: {at: 0, type: float64, byte_order: big, scale: 1000.0}
            stage_y: {at: 8, type: float64, byte_order: big, scale: 1000.0}
            stage_z: {at: 16, type: float64, byte_order: big, scale: 1000.0}
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from micromanip.driver import Section
from micromanip.driver.quantities import Latency, SampleRate

from .frame_options import Counter, Crc, InputField, Known, Status, WholeNumber
from .section import Count, HexBytes, Name


class Blocks(WholeNumber):
    """A number in the header: the blocks that follow."""

    most: Count = Field(description="Largest number; a header with more is invalid.")


class StreamCounter(Counter):
    """A rising number in the header."""

    counts: Literal["packets", "samples"] = Field(
        description="packets: it rises by 1 per packet. samples: it is the number of the packet's first sample."
    )


class DeviceTime(WholeNumber):
    """The device's time of a packet's first sample."""

    unit_s: Annotated[float, Field(strict=True, gt=0, le=1)] = Field(description="Seconds per count.")


class Stream(Section):
    """Packets of samples."""

    magic: HexBytes = Field(min_length=2, description="First bytes of every packet, hexadecimal.")
    header_bytes: Count = Field(description="Length of the header with the magic; the first block follows.")
    block_bytes: Count = Field(description="Length of a block: one sample of every field.")
    blocks: Count | Blocks = Field(default=1, description="Blocks in a packet: a number, or its place in the header.")
    fields: dict[Name, InputField] = Field(min_length=1, description="Inputs by name; their places are in the block.")
    rate_hz: SampleRate = Field(description="Samples per second of each field.")
    counter: StreamCounter | None = Field(
        default=None, description="Counter of packets or samples; null: losses are not detected."
    )
    status: Status | None = Field(default=None, description="Marks the device's values as valid.")
    time: DeviceTime | None = Field(
        default=None, description="The device's clock; null: samples count as old as possible at reception."
    )
    crc: Crc | None = Field(default=None, description="Checksum after the last block.")
    identity: dict[Name, Known] = Field(default={}, description="Numbers of the header that identify the device.")
    start: HexBytes = Field(
        default="", description="Sent at the start to begin the stream, hexadecimal; it must move nothing."
    )
    latency_us: Latency | None = Field(
        default=None,
        description="From the last sample's measurement to its packet's end; null: the packet's time on the wire.",
    )

    @property
    def most_blocks(self) -> int:
        """As many samples as a packet can hold."""
        return self.blocks.most if isinstance(self.blocks, Blocks) else self.blocks

    @model_validator(mode="after")
    def _blocks_are_in_the_header(self) -> Stream:
        for name, field in self.fields.items():
            if field.end > self.block_bytes:
                raise ValueError(f"fields.{name} ends behind the block, which has {self.block_bytes} bytes")
        return self
