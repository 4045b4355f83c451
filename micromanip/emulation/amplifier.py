"""The amplifier that takes the commands of one bus: its watchdog, and what it has seen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .plant import PERIOD_NS, STALL_PERIODS, PlantInRealTime

WATCHDOG_MS = 100.0
"""Default: without a command for this long the outputs go to rest."""
RAMP_NS = 200_000_000
REST_TOLERANCE_V = 0.5
"""A tripped amplifier takes commands again once they are this close to rest: then nothing jumps."""


@dataclass
class Arrived:
    """What came in for one output."""

    minimum: float = math.inf
    maximum: float = -math.inf
    largest_step: float = 0.0
    samples: int = 0
    last: float = math.nan

    def add(self, value: float) -> None:
        """One more command."""
        self.minimum, self.maximum = min(self.minimum, value), max(self.maximum, value)
        if self.last == self.last:
            self.largest_step = max(self.largest_step, abs(value - self.last))
        self.last = value
        self.samples += 1

    def merge(self, other: Arrived) -> None:
        """What somebody else has counted since, from the same last command on."""
        self.minimum, self.maximum = min(self.minimum, other.minimum), max(self.maximum, other.maximum)
        self.largest_step = max(self.largest_step, other.largest_step)
        self.samples += other.samples
        self.last = other.last

    def report(self) -> dict[str, Any]:
        """The figures under their names in reports; None where nothing came."""
        if not self.samples:
            return {"min": None, "max": None, "largest_step_V": None, "samples": 0}
        return {
            "min": self.minimum,
            "max": self.maximum,
            "largest_step_V": self.largest_step,
            "samples": self.samples,
        }


class Amplifier:
    """Hands commands to the plant; rests, and says that it isn't ok, after a time without any.

    The watchdog begins with the first command. It goes by the clock, not by the plant's time, and leaves out what this
    very process was not scheduled for: the commands of that time are still waiting to be read.
    """

    def __init__(self, plant: PlantInRealTime, rest_V: Mapping[str, float], watchdog_ms: float | None) -> None:
        """`rest_V` has the voltage at rest of each analog output of the plant; other outputs are digital.

        `watchdog_ms` None is for one that somebody else watches over.
        """
        self.rest_V = dict(rest_V)
        self.ok = True
        self.trips = 0
        self.refused = 0
        """Commands that were not finite."""
        self.arrived = {name: Arrived() for name in rest_V}
        self.switches: dict[str, Arrived] = {}
        """What came in for digital outputs, where something has."""
        self._plant = plant
        self._watchdog_ns = math.inf if watchdog_ms is None else watchdog_ms * 1e6
        self.in_force = dict(rest_V)
        self._commanded_ns: int | None = None
        self._ticked_ns: int | None = None
        self._ramp_from: dict[str, float] = {}
        self._ramp_ns = 0
        for name, value in rest_V.items():
            plant.write(name, value)

    @property
    def is_commanded(self) -> bool:
        """Whether a command has come."""
        return self._commanded_ns is not None

    def take(self, values: Mapping[str, float], clock_ns: int) -> None:
        """A command for some outputs, come at `clock_ns`; acts from the plant's next advance on."""
        if not all(map(math.isfinite, values.values())):
            self.refused += 1
            return
        self._commanded_ns = clock_ns
        for name in values.keys() & self.arrived.keys():
            self.arrived[name].add(values[name])
        if not self.ok:
            self.ok = not self._ramp_from and self._asks_for_rest(values)
        for name, value in values.items():
            if name not in self.rest_V:
                self.switches.setdefault(name, Arrived()).add(value)
                self._plant.write(name, value)
            elif self.ok:
                self._put(name, value)

    @property
    def follows(self) -> bool:
        """Whether it puts out what it is commanded."""
        return self.ok and not self._ramp_from

    def has_taken(self, arrived: Mapping[str, Arrived], clock_ns: int) -> None:
        """Commands that went to the plant another way while it `follows`, the last at `clock_ns`."""
        self._commanded_ns = clock_ns
        for name, figures in arrived.items():
            if name in self.rest_V:
                self.in_force[name] = figures.last
            kept = self.arrived if name in self.rest_V else self.switches
            kept.setdefault(name, Arrived()).merge(figures)

    def tick(self, clock_ns: int, plant_ns: int) -> None:
        """Time passes, on the clock and in the plant: look after the watchdog and the ramp."""
        before_ns, self._ticked_ns = self._ticked_ns, clock_ns
        if self._commanded_ns is None:
            return
        if before_ns is not None and clock_ns - before_ns >= STALL_PERIODS * PERIOD_NS:
            self._commanded_ns += clock_ns - before_ns
        if self.ok and clock_ns - self._commanded_ns > self._watchdog_ns:
            self.trip(plant_ns)
        if self._ramp_from:
            self._ramp(plant_ns)

    def trip(self, plant_ns: int) -> None:
        """Not ok from now on; the outputs go to rest in 0.2 s and stay there until the commands do."""
        self.trips += self.ok
        self.ok = False
        self._ramp_from, self._ramp_ns = dict(self.in_force), plant_ns

    def take_report(self) -> tuple[dict[str, Arrived], dict[str, Arrived]]:
        """What arrived for analog and digital outputs since the last call; a step from the last command counts too."""
        report = self.arrived, self.switches
        self.arrived, self.switches = {name: Arrived(last=before.last) for name, before in self.arrived.items()}, {}
        return report

    def _ramp(self, plant_ns: int) -> None:
        share = min(1.0, (plant_ns - self._ramp_ns) / RAMP_NS)
        for name, start_V in self._ramp_from.items():
            self._put(name, start_V + (self.rest_V[name] - start_V) * share)
        if share >= 1.0:
            self._ramp_from = {}

    def _put(self, name: str, value: float) -> None:
        self.in_force[name] = value
        self._plant.write(name, value)

    def _asks_for_rest(self, values: Mapping[str, float]) -> bool:
        return all(
            abs(values[name] - rest_V) <= REST_TOLERANCE_V for name, rest_V in self.rest_V.items() if name in values
        )
