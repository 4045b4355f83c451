"""Keys of the driver `canbus`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from micromanip.driver import Section
from micromanip.driver.quantities import Latency, SampleRate

from .link_options import LinkOptions

Milliseconds = Annotated[int, Field(strict=True, ge=10, le=60_000)]


class Status(Section):
    """A signal by which the device says whether its message is to be trusted."""

    signal: str = Field(description="Name of the signal, unsigned.")
    good: tuple[Annotated[int, Field(strict=True, ge=0)], ...] = Field(
        default=(0,), description="Its values that mean good."
    )


class Received(Section):
    """A message that a device sends."""

    rate_hz: SampleRate = Field(description="How often the device sends it.")
    counter: str | None = Field(
        default=None,
        description="Signal that the device increments with each frame: gaps are counted, a repeated one is not fresh.",
    )
    latency_us: Latency | None = Field(
        default=None,
        description="From being measured to the end of the frame; the frame's own longest time if not known.",
    )
    status: Status | None = None


class Sent(Section):
    """A message that is sent to a device, at a fixed rate and with the latest values."""

    rate_hz: SampleRate = Field(description="How often it is sent.")
    counter: str | None = Field(default=None, description="Signal that is incremented with each frame.")
    latency_us: Latency | None = Field(
        default=None, description="From being sent to being in force; the frame's own longest time if not known."
    )


class CanBusOptions(LinkOptions):
    """Frames that a DBC file describes."""

    database: str = Field(description="DBC file, seen from the folder of the configuration.")
    receive: dict[str, Received] = Field(default={}, description="Messages that devices send, by name in the DBC.")
    send: dict[str, Sent] = Field(default={}, description="Messages that are sent, by name in the DBC.")
    silence_ms: Milliseconds | None = Field(
        default=500,
        description="Nothing of `receive` for so long, and the link is lost; it is there with the first frame. null: "
        "silence is no error, for devices that speak only when they are spoken to, or seldom.",
    )
    watchdog: str | None = Field(
        default=None,
        description="What the device does by itself when no frames come, and after how long, in a few words.",
    )

    @model_validator(mode="after")
    def _silence_is_unusual(self) -> CanBusOptions:
        fastest_hz = max((received.rate_hz for received in self.receive.values()), default=None)
        if self.silence_ms is not None and fastest_hz is not None and self.silence_ms * 1e-3 * fastest_hz < 3.0:
            raise ValueError(
                f"silence_ms {self.silence_ms} is less than three periods of what comes most often "
                f"({fastest_hz:g} Hz): make it longer, or null"
            )
        return self
