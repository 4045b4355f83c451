"""Keys of the driver `canbus`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from micromanip.driver import Section, Watchdog
from micromanip.driver.quantities import Latency, SampleRate

from .link_options import LinkOptions

Milliseconds = Annotated[int, Field(strict=True, ge=10, le=60_000)]


class Status(Section):
    """A signal that marks the device's message as valid."""

    signal: str = Field(description="Name of the signal, unsigned.")
    good: tuple[Annotated[int, Field(strict=True, ge=0)], ...] = Field(
        default=(0,), description="Values that mean good."
    )


class Received(Section):
    """A message from a device."""

    rate_hz: SampleRate = Field(description="Rate at which the device sends it.")
    counter: str | None = Field(
        default=None,
        description="Signal that the device increments with each frame: gaps count, repeated frames are not fresh.",
    )
    latency_us: Latency | None = Field(
        default=None,
        description="From measurement to the end of the frame; null: the frame's longest time.",
    )
    status: Status | None = None


class Sent(Section):
    """A message to a device, at a fixed rate, with the latest values."""

    rate_hz: SampleRate = Field(description="Rate at which it is sent.")
    counter: str | None = Field(default=None, description="Signal that the driver increments with each frame.")
    latency_us: Latency | None = Field(
        default=None, description="From sending until the value acts; null: the frame's longest time."
    )


class CanBusOptions(LinkOptions):
    """Frames described by a DBC file."""

    database: str = Field(description="DBC file, relative to the configuration.")
    receive: dict[str, Received] = Field(default={}, description="Messages from devices, by name in the DBC.")
    send: dict[str, Sent] = Field(default={}, description="Messages to devices, by name in the DBC.")
    silence_ms: Milliseconds | None = Field(
        default=500,
        description="Longest silence of `receive`; then the link is lost until the next frame. null: no limit, for "
        "devices that send rarely or on request only.",
    )
    watchdog: Watchdog | None = Field(default=None, description="What the device does by itself; null: nobody knows.")

    @model_validator(mode="after")
    def _silence_is_unusual(self) -> CanBusOptions:
        fastest_hz = max((received.rate_hz for received in self.receive.values()), default=None)
        if self.silence_ms is not None and fastest_hz is not None and self.silence_ms * 1e-3 * fastest_hz < 3.0:
            raise ValueError(
                f"silence_ms {self.silence_ms} is less than three periods of what comes most often "
                f"({fastest_hz:g} Hz): make it longer, or null"
            )
        return self
