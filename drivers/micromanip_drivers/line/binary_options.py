"""Keys of the framing ``binary``: frames with sync bytes, length, kind, counter and CRC, in both directions.

``docs/line.md`` has an example. On a line where a device speaks only when it is asked, a message of `send` names its
answer: ``reply: strains``; one without fields only asks. Channels have the fields' names. A frame is as long as its
last part, and its CRC, unless `bytes` says that it is longer; bytes that nothing covers are sent as 0.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from micromanip.driver import Section, Written
from micromanip.driver.quantities import Latency, SampleRate

from .frame_options import (
    Count,
    Counter,
    Crc,
    HexBytes,
    InputField,
    Known,
    Length,
    Name,
    OutputField,
    Status,
    WholeNumber,
)

Kind = Annotated[int, Field(strict=True, ge=0)]


class _Message(Section):
    kind: Kind | None = Field(default=None, description="Value of binary.kind for this frame.")
    rate_hz: SampleRate = Field(description="Rate of the frame.")
    bytes: Count | None = Field(
        default=None, description="Length of the frame with its CRC; null: to the end of its last part and CRC."
    )
    counter: Counter | None = Field(default=None, description="The sender increments it with each frame of this kind.")
    latency_us: Latency | None = Field(
        default=None,
        description="Received: from measurement to the frame's end. Sent: from sending until the value acts. null: "
        "the frame's time on the wire.",
    )


class Received(_Message):
    """A frame from the device, unrequested or as an answer."""

    status: Status | None = Field(default=None, description="Marks the device's values as valid.")
    fields: dict[Name, InputField] = Field(min_length=1, description="Inputs by name.")


class Sent(_Message, Written):
    """A frame to the device with the latest values; without fields a mere request."""

    fields: dict[Name, OutputField] = Field(default={}, description="Outputs by name.")
    reply: Name | None = Field(
        default=None, description="Message of `receive` that answers it at the same rate; null: no answer."
    )


class BinaryIdentity(Section):
    """The device that must answer, asked at the start."""

    request: HexBytes = Field(min_length=2, description="Request without its CRC, hexadecimal.")
    kind: Kind | None = Field(default=None, description="Kind of the answer.")
    bytes: Count | None = Field(default=None, description="Length of the answer, as for a message.")
    numbers: dict[Name, Known] = Field(min_length=1, description="Expected numbers.")


class Binary(Section):
    """Frames with sync bytes and checksum."""

    sync: HexBytes = Field(min_length=2, description="First bytes of every frame, hexadecimal.")
    length: Length | None = Field(
        default=None, description="Place of the frame's length; null: its kind decides, or there is only one."
    )
    kind: WholeNumber | None = Field(default=None, description="Place of the frame's kind; null: one kind.")
    crc: Crc | None = Field(
        description="Checksum at the end; an explicit null for a device without one: noise becomes values."
    )
    identity: BinaryIdentity | None = Field(default=None, description="The device that must answer; null: any.")
    reply_ms: Annotated[float, Field(strict=True, gt=0, le=250)] = Field(
        default=10.0, description="Longest time of an answer; then it is missing."
    )
    drain_ms: Annotated[float, Field(strict=True, gt=0, le=5_000)] = Field(
        default=20.0,
        description="Silence after a missing answer, for a late one; longer than the device's longest answer time.",
    )
    turnaround_us: Latency = Field(
        default=0.0, description="The device's time until its answer begins, for the budget."
    )
    receive: dict[Name, Received] = Field(default={}, description="Frames from the device, by any name.")
    send: dict[Name, Sent] = Field(default={}, description="Frames to the device, by any name.")

    @model_validator(mode="after")
    def _does_something(self) -> Binary:
        if not self.receive and not self.send:
            raise ValueError("receive or send: at least one message must be given")
        return self
