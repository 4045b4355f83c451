"""The amplifier that takes the commands of one bus: its watchdog, and what it has seen."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from micromanip.rt.jit import plain
from micromanip.rt.record import arrays, fields, record
from micromanip.testbus.event_loop import EventLoop, Timer

from .compiled import compiled
from .plant import PERIOD_NS, STALL_PERIODS, PlantInRealTime

_LATE_NS = 2_000_000
"""A timer that comes later than this was not late: this process stood still."""


class Watchdog:
    """Calls `bite` when nothing has fed it for a time; begins with the first time that it is fed.

    A device has a processor of its own; this process may be held up, and what it was fed meanwhile is not read yet, or
    found no room. So after having stood still it waits once more for as long.
    """

    def __init__(self, loop: EventLoop, bite: Callable[[], None]) -> None:
        self._loop, self._bite = loop, bite
        self._timer: Timer | None = None
        self._fed_ns = self._patience_ns = 0

    def feed(self, time_ns: int, patience_ns: int) -> None:
        """Something came at `time_ns`; the next is due within `patience_ns`."""
        self._fed_ns, self._patience_ns = max(self._fed_ns, time_ns), patience_ns
        if self._timer is None:
            self._wait()

    def stop(self) -> None:
        """Watch no more, until it is fed again."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _wait(self) -> None:
        due_ns = self._fed_ns + self._patience_ns
        self._timer = self._loop.call_at(due_ns, lambda: self._look(due_ns))

    def _look(self, due_ns: int) -> None:
        now_ns = self._loop.now_ns()
        if now_ns - due_ns > _LATE_NS:
            self._fed_ns = now_ns
        if now_ns < self._fed_ns + self._patience_ns:
            self._wait()
        else:
            self._timer = None
            self._bite()


WATCHDOG_MS = 100.0
"""Default: without a command for this long the outputs go to rest."""
RAMP_NS = 200_000_000
REST_TOLERANCE_V = 0.5
"""A tripped amplifier takes commands again once they are this close to rest: then nothing jumps."""

ARRIVED = record(*arrays("i8", 1, "samples"), *arrays("f8", 1, "minimum", "maximum", "largest_step", "last"))
"""What came in for one output since the last report; `last` is not a number before the first command."""


@compiled
def note(a: Any, value: float) -> None:
    """One more command for an output."""
    if a["samples"][0] == 0:
        a["minimum"][0] = a["maximum"][0] = value
    a["minimum"][0], a["maximum"][0] = min(a["minimum"][0], value), max(a["maximum"][0], value)
    if math.isfinite(a["last"][0]):
        a["largest_step"][0] = max(a["largest_step"][0], abs(value - a["last"][0]))
    a["last"][0] = value
    a["samples"][0] += 1


_note = plain(note)


def _taken(a: Any) -> dict[str, Any]:
    """The figures under their names in reports, None where nothing came; they begin anew."""
    samples = a["samples"][0]
    figures = {"min": a["minimum"][0], "max": a["maximum"][0], "largest_step_V": a["largest_step"][0]}
    a["samples"][0], a["largest_step"][0] = 0, 0.0
    return {name: value if samples > 0 else None for name, value in figures.items()} | {"samples": samples}


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
        self._arrived: dict[str, Any] = {}
        self._plant = plant
        self._watchdog_ns = math.inf if watchdog_ms is None else watchdog_ms * 1e6
        self.in_force = dict(rest_V)
        self._commanded_ns: int | None = None
        self._ticked_ns: int | None = None
        self._ramp_from: dict[str, float] = {}
        self._ramp_ns = 0
        for name, value in rest_V.items():
            self.count_in(name, np.zeros(1, ARRIVED)[0])
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
        if not self.ok:
            self.ok = not self._ramp_from and self._asks_for_rest(values)
        for name, value in values.items():
            if name not in self._arrived:
                self.count_in(name, np.zeros(1, ARRIVED)[0])
            _note(self._arrived[name], value)
            if name not in self.rest_V:
                self._plant.write(name, value)
            elif self.ok:
                self._put(name, value)

    @property
    def follows(self) -> bool:
        """Whether it puts out what it is commanded."""
        return self.ok and not self._ramp_from

    def count_in(self, name: str, arrived: Any) -> None:
        """Keep what arrives for an output in this record from now on, where compiled code may count too."""
        arrived["last"] = math.nan
        self._arrived[name] = fields(arrived)

    def has_taken(self, clock_ns: int) -> None:
        """Commands went to the plant another way while it `follows`, the last at `clock_ns`, if that is news."""
        if clock_ns <= (self._commanded_ns or 0):
            return
        self._commanded_ns = clock_ns
        last = {name: self._arrived[name]["last"][0] for name in self.rest_V}
        self.in_force |= {name: volts for name, volts in last.items() if math.isfinite(volts)}

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

    def take_report(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """What arrived for analog outputs, and for digital ones where anything did, since the last call.

        A step from the last command before it counts too.
        """
        analog = {name: _taken(a) for name, a in self._arrived.items() if name in self.rest_V}
        others = {name: a for name, a in self._arrived.items() if name not in self.rest_V}
        return analog, {name: _taken(a) for name, a in others.items() if a["samples"][0] > 0}

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
