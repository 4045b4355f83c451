"""The gate of a bus' outputs (``rt/io/gate.py``) for Python: set up, told where the device is, asked; and passed.

Every value goes to a device through it: `OutputWriter`, which notes what became of it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from micromanip.rt.bus_image import SAFE_RAMP
from micromanip.rt.io import gate as law
from micromanip.rt.io.gate import LAST_SWITCH, SWITCH, UNUSED, VOLTAGE
from micromanip.rt.jit import plain
from micromanip.rt.record import fields

from .driver import BusDriver, Outcome, Task
from .errors import LinkError, OutputRefused
from .inbox import Inbox

Values = Sequence[float]
"""One for each output of the bus' driver."""
Bounds = tuple[float, float]
"""The least and the greatest that something may be."""
Known = Sequence[float | None]
"""The same; None for an output of which nothing is known."""

__all__ = ["LAST_SWITCH", "SWITCH", "UNUSED", "VOLTAGE", "SafeOutput", "SafeState", "Values"]

_may_have_moved, _note_sent, _note_taken = map(plain, (law.may_have_moved, law.note_sent, law.note_taken))
_decide, _leave, _rests, _rests_at, _rest_if_given, _known_last = map(
    plain, (law.decide, law.leave, law.rests, law.rests_at, law.rest_if_given, law.known_last)
)


@dataclass(frozen=True)
class SafeOutput:
    """What the safe state must know of one output; `kind` is VOLTAGE, SWITCH, LAST_SWITCH or UNUSED."""

    kind: int
    safe: float
    low: float = -math.inf
    high: float = math.inf
    slew_V_per_s: float = math.inf


@dataclass(frozen=True)
class Left:
    """An output as it was left."""

    kind: int
    rest: float
    """Where its device leads it by itself; the cell's safe state leads it to `safe`."""
    safe: float
    step: float
    """What is no further apart may follow one on the other."""
    last: float
    given: Bounds | None
    """What it was given; None where nobody knows."""
    register: Bounds
    """What its register may have from here; the first is above the second where nothing was written."""


@dataclass(frozen=True)
class Beginning:
    """The value from which an output goes on, and between which bounds lies what its device has."""

    value: float
    bounds: Bounds


class SafeState:
    """Decides what the device is given."""

    def __init__(
        self,
        outputs: Sequence[SafeOutput],
        tasks: Sequence[Task],
        ramp_s: float,
        dead_ns: int,
        rests: Values | None = None,
        begins_ns: float = math.inf,
    ) -> None:
        """Each output is written by one of `tasks`.

        A loop that has written nothing for `dead_ns` is dead. As long as nothing is known of what the device has, an
        output begins at its safe value. `rests` is where the device's own watchdog leads them, after `begins_ns` of
        silence at the earliest; None: there too.
        """
        self.record = np.zeros(1, law.GATE)
        self.fields = g = fields(self.record[0])
        self._all = range(len(outputs))
        g["outputs"][0], g["state"][0] = len(outputs), SAFE_RAMP
        g["begins_ns"][0] = round(min(begins_ns, 1 << 62))
        task_of = {i: number for number, task in enumerate(tasks) for i in task.outputs}
        for i, output in enumerate(outputs):
            g["task"][i], g["period_s"][i] = task_of[i], 1.0 / tasks[task_of[i]].rate_hz
            g["rest"][i] = output.safe if rests is None else rests[i]
            g["register_low"][i], g["register_high"][i] = math.inf, -math.inf
            for name in ("last", "lowest", "highest", "start"):
                g[name][i] = output.safe
        self.adopt(outputs, ramp_s, dead_ns)
        _rest_if_given(g)

    def adopt(self, outputs: Sequence[SafeOutput], ramp_s: float, dead_ns: int) -> None:
        """From now on by these limits, of the same outputs."""
        self._outputs, g = tuple(outputs), self.fields
        g["ramp_s"][0], g["dead_ns"][0] = ramp_s, dead_ns
        for i, output in enumerate(outputs):
            g["kind"][i], g["safe"][i], g["low"][i], g["high"][i] = output.kind, output.safe, output.low, output.high
            g["step"][i] = output.slew_V_per_s * g["period_s"][i]

    @property
    def state(self) -> int:
        """FOLLOWING, SAFE_RAMP, RESTING (``rt/bus_image.py``)."""
        return int(self.fields["state"][0])

    @property
    def refused(self) -> int:
        """Values of the loop that were not finite or out of range; the one before was kept."""
        return int(self.fields["refused"][0])

    def remember(self, values: Known) -> None:
        """What the device was given last, as another worker noted it; None for nothing at all.

        That one may have sent one value more before it died: it differs by a step at most, so the same again is right.
        """
        g = self.fields
        for i, value in enumerate(values):
            if value is not None:
                more = g["step"][i] if g["kind"][i] == VOLTAGE else 0.0
                self.begin(i, Beginning(value, (value - more, value + more)))
                g["register_low"][i], g["register_high"][i] = g["lowest"][i], g["highest"][i]

    def left(self, i: int) -> Left:
        """Output `i` as it was left."""
        g = self.fields
        return Left(
            self._outputs[i].kind,
            rest=float(g["rest"][i]),
            safe=float(g["safe"][i]),
            step=float(g["step"][i]),
            last=float(g["last"][i]),
            given=(float(g["lowest"][i]), float(g["highest"][i])) if g["known"][i] else None,
            register=(float(g["register_low"][i]), float(g["register_high"][i])),
        )

    def silent_ns(self, i: int, now_ns: int) -> tuple[int, int]:
        """How long the device of output `i` had no command, at least and at most."""
        g = self.fields
        return now_ns - int(g["touched_ns"][0]), now_ns - int(g["fed_ns"][g["task"][i]])

    def begin(self, i: int, beginning: Beginning) -> None:
        """Output `i` is there; one outside of its range is at the nearest bound.

        Where it is what was expected, a ramp under way goes on.
        """
        g = self.fields
        value = min(max(beginning.value, g["low"][i]), g["high"][i])
        under_way = g["share"][i] > 0.0 and abs(value - g["last"][i]) <= g["step"][i]
        if not under_way:
            g["share"][i] = 0.0
        if not under_way or abs(value - g["safe"][i]) <= g["step"][i]:  # at rest already: it would be led away
            g["start"][i] = value
        g["lowest"][i], g["highest"][i] = beginning.bounds
        g["last"][i], g["known"][i] = value, 1

    def assume_safe(self, *, where_unknown: bool = False) -> None:
        """Take the voltages, `where_unknown` those of which nothing is known, for being at their safe values.

        Where all of them are, a register may read whatever it likes.
        """
        g = self.fields
        for i, output in enumerate(self._outputs):
            if output.kind == VOLTAGE and not (where_unknown and g["known"][i]):
                self.begin(i, Beginning(output.safe, (output.safe, output.safe)))
                if not where_unknown:
                    g["register_low"][i], g["register_high"][i] = -math.inf, math.inf

    def leave(self) -> None:
        """The device is not in the loop's hand any more, and what it has is not known to be at rest."""
        _leave(self.fields)

    def is_dead(self, written_ns: int, now_ns: int) -> bool:
        """Whether the loop, which wrote last at `written_ns`, has been silent for too long."""
        return bool(now_ns - written_ns > self.fields["dead_ns"][0])

    def decide(self, wanted: Values, written_ns: int, now_ns: int) -> None:
        """What the device is to be given next, where the loop wanted `wanted` at `written_ns`: `values`."""
        g = self.fields
        g["written_ns"][0] = written_ns
        for i, value in enumerate(wanted):
            g["wanted"][i] = value
        _decide(g, now_ns)

    @property
    def decided_ns(self) -> int:
        """When that was; 0 for never."""
        return int(self.fields["decided_ns"][0])

    @property
    def values(self) -> list[float]:
        """What was decided."""
        found: list[float] = self.fields["value"][: len(self._all)].tolist()
        return found

    @property
    def last(self) -> list[float]:
        """What the device was given last; NaN where nobody knows."""
        return [_known_last(self.fields, i) for i in self._all]

    @property
    def unsafe(self) -> list[int]:
        """Outputs of which it is not known that they are at rest."""
        return [i for i in self._all if not _rests_at(self.fields, i)]

    @property
    def rests(self) -> bool:
        """Whether the device is known to have the safe value of every voltage, and `values` leave it there."""
        return bool(_rests(self.fields))

    def outside(self, values: Known) -> list[int]:
        """Which of these values no device may have: they are outside of the outputs' ranges."""
        pairs = enumerate(zip(values, self._outputs, strict=True))
        return [i for i, (value, output) in pairs if value is not None and not output.low <= value <= output.high]


class OutputWriter:
    """Does the tasks of a driver with what its gate lets through."""

    def __init__(self, driver: BusDriver, safe: SafeState, noted: Callable[[Sequence[float]], None]) -> None:
        """`noted` gets what the outputs were given last (NaN: nobody knows) whenever the device has taken something."""
        self._driver, self._safe, self._noted, self._gate = driver, safe, noted, safe.fields
        self._gate["touched_ns"][0] = time.monotonic_ns()
        self._confirmed: list[int] = []

    def perform(self, number: int, inbox: Inbox) -> Outcome | None:
        """Do task `number` with what was decided, and tell the gate what became of it.

        Returns what the driver does, raises what it does; and LinkError where the device's watchdog may have moved it.
        """
        began_ns, outputs = time.monotonic_ns(), self._driver.tasks[number].outputs
        if outputs and _may_have_moved(self._gate, number, began_ns):
            raise LinkError(
                f"{self._driver.tasks[number].name}: the device took no values for longer than its watchdog waits "
                "(watchdog.ms): it may have gone to rest by itself"
            )
        try:
            outcome = self._driver.perform(number, self._safe.values, inbox)
        except BaseException as problem:
            self._confirmed += self._taken(inbox)
            if outputs and not isinstance(problem, OutputRefused):
                _note_sent(self._gate, number, began_ns, time.monotonic_ns())
            raise
        self._confirmed += self._taken(inbox)
        if outputs and outcome is not Outcome.HELD:
            _note_sent(self._gate, number, began_ns, time.monotonic_ns())
            if outcome is not Outcome.SENT:
                self._take(number)
        return outcome

    def take_confirmed(self, inbox: Inbox) -> list[int]:
        """What the device has said to have taken, as it was sent before; of which tasks, since the last call."""
        confirmed, self._confirmed = self._confirmed + self._taken(inbox), []
        return confirmed

    def found_still(self) -> None:
        """The device's watchdog has had its time, and what it has is known."""
        for number in range(len(self._driver.tasks)):
            self._gate["still"][number] = 1

    @property
    def touched_ns(self) -> int:
        """When the device may have had a command last, at the latest; of whoever had it before, too."""
        return int(self._gate["touched_ns"][0])

    def taken_s(self, number: int) -> float:
        """When what the device took last of a task was sent (time.monotonic), 0 for never."""
        return 1e-9 * float(self._gate["fed_ns"][number])

    def forget(self) -> None:
        """What was sent over a link that is gone is not confirmed any more."""
        for number in range(len(self._driver.tasks)):
            self._gate["unconfirmed"][number] = 0

    def _taken(self, inbox: Inbox) -> list[int]:
        confirmed = inbox.take_confirmed()  # once: what is sent after it is not confirmed by it
        for number in confirmed:
            self._take(number)
        return confirmed

    def _take(self, number: int) -> None:
        if _note_taken(self._gate, number, time.monotonic_ns()):
            self._noted(self._safe.last)
