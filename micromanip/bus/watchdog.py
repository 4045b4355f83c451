"""What a device does by itself once no more commands come, as its configuration says it.

The link tells whether commands arrive, not what the device did meanwhile: its watchdog may have led it to rest, and it
may have been switched off and on. ``beginning.py`` says where its outputs are then.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from .number_options import Section

Milliseconds = Annotated[float, Field(strict=True, gt=0, le=6_500)]
"""As long as the watchdog of an EtherCAT terminal can be; one that is longer guards nothing anyhow."""

_SHARE = 0.9
"""A device that had no command for this part of its watchdog's time can't be known to have its last value still. So
late may a command arrive, by the rest of that time, and its watchdog begin anew."""


class Watchdog(Section):
    """The device's own reaction to missing commands, and to being switched on; its rest is `safe` of each output."""

    ms: Milliseconds | None = Field(
        description="Time without commands until the device begins to go to rest; null: it keeps its values."
    )
    rest_ms: Annotated[float, Field(strict=True, ge=0, le=10_000)] = Field(
        default=0.0, description="Longest time from then until all outputs are at their `safe` values."
    )
    latches: bool = Field(
        default=False, strict=True, description="After that the device takes commands only when somebody has reset it."
    )
    after_power_on: Literal["rest", "last", "unknown"] = Field(
        description="Outputs after a power cycle: at their `safe` values, at the last values, or unknown."
    )

    @property
    def begins_ns(self) -> float:
        """Silence after which it may have begun to go to rest."""
        return math.inf if self.ms is None else _SHARE * 1e6 * self.ms

    @property
    def still_ns(self) -> int:
        """Silence after which it is at rest, if it ever is."""
        return 0 if self.ms is None else round(1e6 * ((2.0 - _SHARE) * self.ms + self.rest_ms))

    @property
    def leads_to_rest(self) -> bool:
        """Whether it is at rest after a silence, switched off and on meanwhile or not."""
        return self.ms is not None and self.after_power_on == "rest"

    @property
    def keeps(self) -> bool:
        """Whether it always has what it was given last."""
        return self.ms is None and self.after_power_on == "last"

    @property
    def words(self) -> str | None:
        """What it does when this machine has died; None where it does nothing."""
        if self.ms is None:
            return None
        return f"at rest {self.rest_ms:g} ms after {self.ms:g} ms of silence" + (", latching" if self.latches else "")
