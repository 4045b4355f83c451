"""Keys of a wire that the loop itself serves."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from .number_options import Commanded, Section
from .watchdog import Milliseconds, Watchdog


class LoopOutput(Commanded):
    """A value sent to the device in every cycle."""

    switch: bool = Field(
        default=False,
        strict=True,
        description="Digital output: need not be at rest before the outputs follow the loop again.",
    )


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
