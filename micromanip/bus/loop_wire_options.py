"""Keys of a wire that the loop itself serves."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from .number_options import Commanded, Section

Milliseconds = Annotated[float, Field(strict=True, gt=0, le=6_500)]
"""As long as the watchdog of an EtherCAT terminal can be; one that is longer guards nothing anyhow."""


class LoopOutput(Commanded):
    """A value sent to the device in every cycle."""

    switch: bool = Field(
        default=False,
        strict=True,
        description="Digital output: need not be at rest before the outputs follow the loop again.",
    )


class Watchdog(Section):
    """The device's own reaction to missing frames: it brings the outputs to rest, whichever process has died."""

    ms: Milliseconds = Field(description="Time without outputs until it begins.")
    rest_ms: Annotated[float, Field(strict=True, ge=0, le=10_000)] = Field(
        description="Time from there until all outputs are at their `safe` values."
    )
    does: str = Field(min_length=1, description="Its action, in a few words.")


class LoopWireOptions(Section):
    """Keys of every driver in the loop."""

    simulated: bool = Field(
        default=False,
        strict=True,
        description="The device is `micromanip device simulate`: nothing real moves. Refused for another machine or a "
        "real network interface.",
    )
    silence_ms: Milliseconds = Field(
        default=5.0, description="Longest time without a complete answer; then the link is lost."
    )
    watchdog: Watchdog | None = Field(default=None, description="Required where there are outputs.")
    wait_us: Annotated[float, Field(strict=True, ge=0, le=1000)] = Field(
        default=0.0,
        description="Spin for this cycle's answer until this long after the deadline; 0: use the previous cycle's.",
    )
