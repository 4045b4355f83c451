"""Keys of the driver ``udp``: a device that gets a datagram in every cycle of the loop, and answers with one.

``config/udp.yaml`` is an example. Channels have the fields' names. A datagram is as long as its last part, and its CRC,
unless `bytes` says that it is longer; bytes that nothing covers are sent as 0.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from micromanip.driver import Section, Written
from micromanip.driver.quantities import Latency, SampleRate
from micromanip.driver.wire import LoopOutput, LoopWireOptions, Milliseconds
from micromanip_drivers.line.frame_options import (
    Count,
    Counter,
    Crc,
    HexBytes,
    InputField,
    Known,
    Name,
    OutputField,
    Status,
    WholeNumber,
)
from micromanip_drivers.line.options import UdpPort


class Clock(WholeNumber):
    """The device's time of sampling; it wraps at the end of its type."""

    unit_us: Annotated[float, Field(strict=True, gt=0, le=1e6)] = Field(description="Length of one count.")


class Slow(Section):
    """Values sampled more rarely than their datagram is sent."""

    rate_hz: SampleRate = Field(description="Sample rate.")
    counter: Counter = Field(description="Changes with each sample.")
    latency_us: Latency = Field(description="Mean time from sampling to the first datagram with the sample.")
    fields: dict[Name, InputField] = Field(min_length=1, description="Inputs by name.")


class Received(Section):
    """The answer."""

    head: HexBytes = Field(default="", description="First bytes, hexadecimal; a datagram with others is dropped.")
    bytes: Count | None = Field(
        default=None, description="Length of the datagram with its CRC; null: to the end of its last part and CRC."
    )
    counter: Counter = Field(description="Incremented with each datagram: a repeated or overtaken one is not fresh.")
    acknowledges: Counter | None = Field(
        default=None,
        description="Counter of the last datagram that took effect in the device; required where there are outputs.",
    )
    clock: Clock | None = Field(
        default=None, description="The device's clock; null: a sample's age counts from the kernel's time of reception."
    )
    status: Status | None = Field(default=None, description="Marks the device's values as valid.")
    latency_us: Latency = Field(default=0.0, description="From sampling to the time stamp, or to sending.")
    fields: dict[Name, InputField] = Field(min_length=1, description="Inputs that are fresh each time, by name.")
    slow: dict[Name, Slow] = Field(default={}, description="Groups of slower inputs, by any name.")


class Output(LoopOutput, OutputField):
    """A value to the device."""


class Sent(Written):
    """The datagram sent in every cycle."""

    head: HexBytes = Field(default="", description="First bytes, hexadecimal.")
    bytes: Count | None = Field(
        default=None, description="Length of the datagram with its CRC; null: to the end of its last part and CRC."
    )
    counter: Counter = Field(description="Incremented with each datagram.")
    fields: dict[Name, Output] = Field(default={}, description="Outputs by name; none: a mere request.")


class Identity(Section):
    """The device that must answer, asked before the loop begins."""

    request: HexBytes = Field(min_length=2, description="Request without its CRC, hexadecimal.")
    head: HexBytes = Field(default="", description="First bytes of the answer, hexadecimal.")
    bytes: Count | None = Field(default=None, description="Length of the answer, as for `receive`.")
    numbers: dict[Name, Known] = Field(min_length=1, description="Expected numbers: serial number, version.")


class UdpOptions(UdpPort, LoopWireOptions):
    """A device that answers each datagram with one."""

    crc: Crc | None = Field(description="Checksum at the end; an explicit null for a device that relies on UDP's own.")
    identity: Identity | None = Field(default=None, description="The device that must answer; null: any.")
    restart_ms: Milliseconds = Field(
        default=0.5,
        description="The device can't be off and on again in less; without an answer for so long it is sent nothing "
        "until one comes.",
    )
    receive: Received = Field(description="The answer.")
    send: Sent = Field(description="The datagram sent.")

    @model_validator(mode="after")
    def _outputs_are_acknowledged(self) -> UdpOptions:
        if self.send.fields and self.receive.acknowledges is None:
            raise ValueError(
                "receive.acknowledges must be given: where in its answer the device says which datagram it has acted "
                "on last; without it nobody knows what it has after some were lost, and it might be made to step"
            )
        if self.receive.acknowledges is not None and self.receive.acknowledges.size != self.send.counter.size:
            raise ValueError(
                f"receive.acknowledges.type: {self.receive.acknowledges.type}, but it gives back send.counter, which "
                f"is {self.send.counter.type}: both must be as long"
            )
        return self
