"""The gate of a bus' outputs (``rt/io/gate.py``) for Python: set up, told where the device is, asked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from micromanip.rt.bus_image import SAFE_RAMP
from micromanip.rt.io import gate as law
from micromanip.rt.io.gate import EQUAL_V, LAST_SWITCH, SWITCH, UNUSED, VOLTAGE
from micromanip.rt.jit import plain
from micromanip.rt.record import fields

from .driver import Task
from .watchdog import UNKNOWN, Watchdog, after_silence

Values = Sequence[float]
"""One for each output of the bus' driver."""
Known = Sequence[float | None]
"""The same; None for an output of which nothing is known."""

__all__ = ["LAST_SWITCH", "SWITCH", "UNUSED", "VOLTAGE", "Known", "SafeOutput", "SafeState", "Values"]

_decide, _leave, _rests, _rests_at, _rest_if_given, _settle, _furthest, _is_near_rest, _known_last = map(
    plain,
    (
        law.decide,
        law.leave,
        law.rests,
        law.rests_at,
        law.rest_if_given,
        law.settle,
        law.furthest,
        law.is_near_rest,
        law.known_last,
    ),
)


@dataclass(frozen=True)
class SafeOutput:
    """What the safe state must know of one output; `kind` is VOLTAGE, SWITCH, LAST_SWITCH or UNUSED."""

    kind: int
    safe: float
    low: float = -math.inf
    high: float = math.inf
    slew_V_per_s: float = math.inf


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
                self._begin_at(i, value)
                if g["kind"][i] == VOLTAGE:
                    g["lowest"][i] -= g["step"][i]
                    g["highest"][i] += g["step"][i]
                g["register_low"][i], g["register_high"][i] = g["lowest"][i], g["highest"][i]

    def read_back(self, values: Known) -> None:
        """What the device says that it has; one that lies outside of its range begins at the nearest bound.

        Where it is what was expected, a ramp under way goes on.
        """
        for i, value in enumerate(values):
            if value is None:
                continue
            if self._is_on_the_way(i, value):
                _settle(self.fields, i, value)
                self.fields["last"][i], self.fields["known"][i] = value, 1
            else:
                self._begin_at(i, value)

    def after_silence(self, watchdog: Watchdog | None, silent_ns: int, values: Known) -> list[int]:
        """What the device has once its link was opened, `silent_ns` after the last command: which voltages are unknown.

        `values` is what it reads back, which goes before all else but for a register that may tell a set-point and not
        the output: one that still reads what was written last, long after the watchdog has led the output to rest; any
        away from rest, where nobody knows what the device has after power-on, or said what it does in silence. If that
        is not what was written either, somebody else has, or the last values were lost: it is unknown. One that was
        given its safe value last rests where the watchdog does not say it: so a person's word is asked for once.
        """
        g, unknown, values = self.fields, [], list(values)
        still = watchdog is not None and watchdog.ms is not None and silent_ns >= watchdog.still_ns
        for i, output in enumerate(self._outputs):
            if output.kind != VOLTAGE:
                continue
            if still:
                g["led"][i] = 1
            if (value := values[i]) is not None:
                if not self._may_be_a_set_point(i, value, watchdog):
                    continue
                if self._reads_away(i, value) and not self._may_have_been_written(i, value):
                    unknown.append(i)
                    continue
                values[i] = None
            given = (g["lowest"][i], g["highest"][i]) if g["known"][i] else UNKNOWN
            low, high = after_silence(watchdog, silent_ns, given, g["rest"][i])
            if low == high and (low, high) != given:
                self._begin_at(i, low)
            elif math.isfinite(low) and math.isfinite(high):
                g["lowest"][i], g["highest"][i] = low, high
            elif not g["known"][i] or _furthest(g, i, output.safe) > g["step"][i] + EQUAL_V:
                unknown.append(i)
                continue
            if (low, high) != given and _furthest(g, i, output.safe) <= g["step"][i] + EQUAL_V:
                g["last"][i] = g["start"][i] = output.safe  # from what it was given, one at rest would leave it
        self.read_back(values)
        return unknown

    def _may_be_a_set_point(self, i: int, value: float, watchdog: Watchdog | None) -> bool:
        """Whether what output `i` reads may be left from before it went to rest by itself."""
        leads = watchdog is not None and watchdog.leads_to_rest
        if watchdog is not None and (not self.fields["led"][i] or (leads and self._is_unwritten(i))):
            return False
        return self._reads_away(i, value) or (leads and self._may_have_been_written(i, value))

    def _is_unwritten(self, i: int) -> bool:
        """Whether nothing is known to have been written to its register, which so moved with its output."""
        return bool(self.fields["register_low"][i] > self.fields["register_high"][i])

    def _reads_away(self, i: int, value: float) -> bool:
        return bool(
            self._outputs[i].kind == VOLTAGE and abs(value - self.fields["rest"][i]) > self.fields["step"][i] + EQUAL_V
        )

    def _may_have_been_written(self, i: int, value: float) -> bool:
        """Whether the register of output `i` may have `value` from here, or a person vouched for whatever it reads."""
        g, step = self.fields, self.fields["step"][i]
        return bool(g["register_low"][i] - step <= value <= g["register_high"][i] + step)

    def assume_safe(self, *, where_unknown: bool = False) -> None:
        """Take the voltages, `where_unknown` those of which nothing is known, for being at their safe values.

        Where all of them are, a register may read whatever it likes.
        """
        g = self.fields
        for i, output in enumerate(self._outputs):
            if output.kind == VOLTAGE and not (where_unknown and g["known"][i]):
                self._begin_at(i, output.safe)
                if not where_unknown:
                    g["register_low"][i], g["register_high"][i] = -math.inf, math.inf

    def is_near_rest(self, values: Known) -> bool:
        """Whether it makes no step where the device's watchdog leads the voltages, and none reads otherwise."""
        return all(
            _is_near_rest(self.fields, i) and (value is None or not self._reads_away(i, value))
            for i, value in enumerate(values)
        )

    def all_told(self, values: Known) -> bool:
        """Whether `values` has every voltage."""
        pairs = zip(values, self._outputs, strict=True)
        return all(value is not None or output.kind != VOLTAGE for value, output in pairs)

    def _is_on_the_way(self, i: int, value: float) -> bool:
        """Whether it lies where the ramp is, or a step beside that; one at rest would be led away from it."""
        g, step = self.fields, self.fields["step"][i]
        return bool(abs(value - g["last"][i]) <= step < abs(value - g["safe"][i]))

    def _begin_at(self, i: int, value: float) -> None:
        g = self.fields
        value = min(max(value, g["low"][i]), g["high"][i])
        _settle(g, i, value)
        g["last"][i] = g["start"][i] = value
        g["known"][i], g["share"][i] = 1, 0.0

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
