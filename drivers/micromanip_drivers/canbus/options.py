"""Keys of the driver `canbus`."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from .link_options import LinkOptions

Rate = Annotated[float, Field(strict=True, gt=0, le=20_000)]
Latency = Annotated[float, Field(strict=True, ge=0, le=1e6)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Status(_Section):
    """A signal by which the device says whether its message is to be trusted."""

    signal: str = Field(description="Name of the signal, unsigned.")
    good: tuple[Annotated[int, Field(strict=True, ge=0)], ...] = Field(
        default=(0,), description="Its values that mean good."
    )


class Received(_Section):
    """A message that a device sends."""

    rate_hz: Rate = Field(description="How often the device sends it.")
    counter: str | None = Field(
        default=None,
        description="Signal that the device increments with each frame: gaps are counted, a repeated one is not fresh.",
    )
    latency_us: Latency | None = Field(
        default=None,
        description="From being measured to the end of the frame; the frame's own longest time if not known.",
    )
    status: Status | None = None


class Sent(_Section):
    """A message that is sent to a device, at a fixed rate and with the latest values."""

    rate_hz: Rate = Field(description="How often it is sent.")
    counter: str | None = Field(default=None, description="Signal that is incremented with each frame.")
    latency_us: Latency | None = Field(
        default=None, description="From being sent to being in force; the frame's own longest time if not known."
    )


class CanBusOptions(LinkOptions):
    """Frames that a DBC file describes."""

    database: str = Field(description="DBC file, seen from the folder of the configuration.")
    receive: dict[str, Received] = Field(default={}, description="Messages that devices send, by name in the DBC.")
    send: dict[str, Sent] = Field(default={}, description="Messages that are sent, by name in the DBC.")
    watchdog: str | None = Field(
        default=None,
        description="What the device does by itself when no frames come, and after how long, in a few words.",
    )
