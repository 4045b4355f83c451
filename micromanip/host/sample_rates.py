"""Whether the samples of each sensor come as often as its driver states: filters and gains are made for that rate.

A gauge that comes at a third of its rate is no fault, and nothing stops for it; its axis only acts by the calm gains
for good (W-217, which speaks of samples that are missing). So it is told for what it is, with figures, while it is so.

Judged is the median interval between samples, which neither a burst of losses nor an interrupted beam changes, in
cycles that ran: what the loop misses is not the sensor's doing. What came and was refused, at an end of a range for
instance, came all the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from micromanip.settings.wiring.timing import signal_timing

from .controller import Controller

_ROLES = (("strain", 1), ("stage", 2), ("deviation", 4))
_TOO_LONG, _TOO_FEW = 1.5, 0.75
"""Of the stated interval, and of the stated rate; both must be so. Gains bear twice the interval, with less margin."""
_LEAST_S, _INTERVALS, _LEAST_INTERVALS = 1.0, 60, 8


@dataclass
class _Block:
    """What is gathered of one signal until it is judged."""

    rows: int = 0
    refused: int = 0
    """What the loop had refused of it when the block began."""
    samples: list[int] = field(default_factory=list)
    """Rows with a fresh sample, counted from the block's begin."""


@dataclass(frozen=True)
class Slow:
    """A signal that comes less often than is stated, Hz."""

    stated_hz: float
    comes_hz: float
    driver: str

    def warning(self, name: str) -> str:
        """For people, with the next step."""
        doing = ""
        if name.startswith("strain_") and self.comes_hz < 0.5 * self.stated_hz:
            doing = ", and its axis acts by its calm gains as long as that lasts (W-217)"
        return (
            f"{name} comes {self.comes_hz:.0f} times a second, its driver {self.driver} states {self.stated_hz:.0f}: "
            f"the loops are made for that{doing}. Let the device send as often, or state the rate that comes in "
            f"drivers.{self.driver} and commission again"
        )


class SampleRates:
    """Follows the sensors of one controller, row by row."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._blocks: dict[str, _Block] = {}
        self._slow: dict[str, Slow] = {}
        self._told: set[str] = set()

    def add(self, rows: Any) -> None:
        """Take in rows of the telemetry ring; a row is a cycle that ran."""
        configuration = self._controller.prepared.configuration
        for i, axis in enumerate(configuration.axes):
            for role, bit in _ROLES:
                name = f"{role}_{axis}"
                if name not in configuration.signals:
                    continue
                refused = int(self._controller.status["state"][0]["axis"][i][role]["refused"])
                block = self._blocks.setdefault(name, _Block(refused=refused))
                fresh = np.flatnonzero(rows["axis"]["fresh"][:, i] & bit)
                block.samples += (fresh + block.rows).tolist()
                block.rows += len(rows)
                if block.rows >= self._enough(name):
                    self._judge(name, block, refused - block.refused)
                    self._blocks[name] = _Block(refused=refused)

    def slow(self) -> list[str]:
        """Each signal that comes less often than is stated, a sentence."""
        return [slow.warning(name) for name, slow in self._slow.items()]

    def news(self) -> list[str]:
        """Those of `slow` that were not in it before."""
        new = [name for name in self._slow if name not in self._told]
        self._told.update(new)
        return [self._slow[name].warning(name) for name in new]

    def stated_hz(self, name: str) -> float:
        """What the driver of a signal states, at most the loop's own rate."""
        prepared = self._controller.prepared
        return signal_timing(prepared.configuration, prepared.wiring, name).rate_hz

    def _enough(self, name: str) -> float:
        """Rows that are judged together."""
        rate_hz = self._controller.prepared.configuration.loop.rate_hz
        return max(_LEAST_S, _INTERVALS / self.stated_hz(name)) * rate_hz

    def _judge(self, name: str, block: _Block, refused: int) -> None:
        configuration = self._controller.prepared.configuration
        rate_hz, stated_hz = float(configuration.loop.rate_hz), self.stated_hz(name)
        self._slow.pop(name, None)
        if len(block.samples) <= _LEAST_INTERVALS:  # silent, or nearly: others tell
            return
        interval = float(np.median(np.diff(block.samples)))
        came_hz = (len(block.samples) + refused) / block.rows * rate_hz
        if interval >= _TOO_LONG * rate_hz / stated_hz and came_hz <= _TOO_FEW * stated_hz:
            self._slow[name] = Slow(stated_hz, rate_hz / interval, configuration.signals[name].driver)
