"""How warm the cell is, by the signal ``temperature``: for memories, which are of one temperature."""

from __future__ import annotations

import math
from typing import Any

from micromanip.settings.check import Prepared

_LATE_NS = 1_000_000_000
"""So much older than it may be a value is still good: this is read by a process that is in no hurry."""


class Thermometer:
    """Reads the signal `temperature` of one configuration off the process image; None where it has none."""

    def __init__(self, prepared: Prepared) -> None:
        self._place = prepared.wiring.signal("temperature")
        self._age_ns = math.inf
        if self._place >= 0:
            age_us = prepared.configuration.signals["temperature"].max_age_us
            self._age_ns = _LATE_NS + 1e3 * (age_us or math.inf)

    def read_C(self, signals: Any, now_ns: int) -> float | None:
        """Temperature, degC, by `signals` (of SIGNAL) at `now_ns`; None where no usable value is there."""
        if self._place < 0:
            return None
        signal = signals[self._place]
        value = float(signal["value"])
        is_old = now_ns - int(signal["time_ns"]) > self._age_ns
        return None if signal["sequence"] == 0 or signal["status"] != 0 or is_old or not math.isfinite(value) else value
