"""Keys of the framing ``stream``: packets with a header, a counter and blocks of samples, that come by themselves.

``docs/line.md`` has an example.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from micromanip.driver import Section
from micromanip.driver.quantities import Latency, SampleRate

from .frame_options import Count, Counter, Crc, HexBytes, InputField, Known, Name, Status, WholeNumber


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
