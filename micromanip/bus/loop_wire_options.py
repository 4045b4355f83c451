"""Keys of a wire that the loop itself serves."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from .number_options import Commanded, Section

Milliseconds = Annotated[float, Field(strict=True, gt=0, le=6_500)]
"""As long as the watchdog of an EtherCAT terminal can be; one that is longer guards nothing anyhow."""


class LoopOutput(Commanded):
    """A value that the device is given in every cycle."""

    switch: bool = Field(
        default=False,
        strict=True,
        description="A line that is on or off: need not be at rest before the outputs follow the loop again.",
    )


class Watchdog(Section):
    """What the device does by itself when nothing comes: it is what brings the outputs to rest, whoever has died."""

    ms: Milliseconds = Field(description="After so long without outputs it begins.")
    rest_ms: Annotated[float, Field(strict=True, ge=0, le=10_000)] = Field(
        description="So long it takes then until all outputs are at their `safe` values."
    )
    does: str = Field(min_length=1, description="What it does, in a few words.")


class LoopWireOptions(Section):
    """What every such driver is told."""

    simulated: bool = Field(
        default=False,
        strict=True,
        description="What answers is `micromanip device simulate`: nothing real moves. Refused for another machine, or "
        "a real network interface.",
    )
    silence_ms: Milliseconds = Field(
        default=5.0, description="Nothing complete came back for so long: the link is lost."
    )
    watchdog: Watchdog | None = Field(default=None, description="Must be given where there are outputs.")
    wait_us: Annotated[float, Field(strict=True, ge=0, le=1000)] = Field(
        default=0.0,
        description="Spin for the answer of this very cycle until so long after the deadline; 0: take that of the "
        "cycle before.",
    )
