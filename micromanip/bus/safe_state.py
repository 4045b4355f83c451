"""The safe state of a bus' outputs, and the gate that every value passes on its way to the device.

    FOLLOWING   the device is given what the loop decides
    SAFE_RAMP   smoothly to the safe values, from what the device was given last
    RESTING     the device was given the safe values; until the loop itself asks for just these: then nothing jumps

In every state a voltage stays in its range, and differs from the last one by at most its slew limit times the period
of the task that writes it, however long the break was. Nothing here goes by the clock but the question whether the
loop is alive: the ramp advances with values that the device was given, by one period each, and rest is reached when
it was given them. Where it is not known whether a value arrived, the next one is near enough to all that the device
may have (``docs/decisions/0017-bus-workers.md``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from micromanip.rt.bus_image import FOLLOWING, RESTING, SAFE_RAMP
from micromanip.rt.laws.minimum_jerk import minimum_jerk
from micromanip.rt.steady import records

from .watchdog import UNKNOWN, Watchdog, after_silence

Values = Sequence[float]
"""One for each output of the bus' driver."""
Known = Sequence[float | None]
"""The same; None for an output of which nothing is known."""

VOLTAGE, SWITCH, LAST_SWITCH, UNUSED = "voltage", "switch", "last switch", "unused"
"""Kinds of output: goes on the ramp; to its safe value at once; when all voltages are at rest; always there."""
_COMPILED_KINDS = {
    VOLTAGE: records.VOLTAGE,
    SWITCH: records.SWITCH,
    LAST_SWITCH: records.SWITCH,
    UNUSED: records.UNUSED,
}
_EQUAL_V = 1e-9


@dataclass(frozen=True)
class SafeOutput:
    """What the safe state must know of one output."""

    kind: str
    safe: float
    low: float = -math.inf
    high: float = math.inf
    slew_V_per_s: float = math.inf


class SafeState:
    """Decides what the device is given."""

    def __init__(
        self,
        outputs: Sequence[SafeOutput],
        periods_s: Sequence[float],
        ramp_s: float,
        dead_ns: int,
        rests: Values | None = None,
    ) -> None:
        """`periods_s` are those of the tasks that write the outputs, one for each output.

        A loop that has written nothing for `dead_ns` is dead. As long as nothing is known of what the device has, an
        output begins at its safe value. `rests` is where the device's own watchdog leads them; None: there too.
        """
        self._rests_at = [output.safe for output in outputs] if rests is None else list(rests)
        self._periods_s = periods_s
        self._last = [output.safe for output in outputs]
        self._lowest, self._highest = list(self._last), list(self._last)  # what the device may have
        self._sent: list[tuple[float, float]] = [UNKNOWN] * len(outputs)
        """Between what its register may hold, wherever the output went by itself; ``UNKNOWN``: nothing was sent."""
        self._led = [False] * len(outputs)  # to rest by the watchdog, and given nothing since
        self._start, self._share = list(self._last), [0.0] * len(outputs)
        self._known, self._given = [False] * len(outputs), [False] * len(outputs)  # ever, and since it was left
        self.state = SAFE_RAMP
        self.refused = 0
        """Values of the loop that were not finite or out of range; the one before was kept."""
        self.adopt(outputs, ramp_s, dead_ns)
        self._rest_if_given()

    def adopt(self, outputs: Sequence[SafeOutput], ramp_s: float, dead_ns: int) -> None:
        """From now on by these limits, of the same outputs."""
        self._outputs, self._ramp_s, self._dead_ns = tuple(outputs), ramp_s, dead_ns
        self._steps = [output.slew_V_per_s * period for output, period in zip(outputs, self._periods_s, strict=True)]

    def remember(self, values: Known) -> None:
        """What the device was given last, as another worker noted it; None for nothing at all.

        That one may have sent one value more before it died: it differs by a step at most, so the same again is right.
        """
        for i, value in enumerate(values):
            if value is not None:
                self._begin_at(i, value)
                if self._outputs[i].kind == VOLTAGE:
                    self._lowest[i] -= self._steps[i]
                    self._highest[i] += self._steps[i]
                self._sent[i] = self._lowest[i], self._highest[i]

    def read_back(self, values: Known) -> None:
        """What the device says that it has; one that lies outside of its range begins at the nearest bound.

        Where it is what was expected, a ramp under way goes on.
        """
        for i, value in enumerate(values):
            if value is None:
                continue
            step = self._steps[i]
            if self._lowest[i] - step <= value <= self._highest[i] + step:
                self._last[i] = self._lowest[i] = self._highest[i] = value
                self._known[i] = True
            else:
                self._begin_at(i, value)

    def after_silence(self, watchdog: Watchdog | None, silent_ns: int, values: Known) -> list[int]:
        """What the device has once its link was opened, `silent_ns` after the last command: which voltages are unknown.

        `values` is what it reads back, which goes before all else but for a register: one that still reads what was
        written last, long after the watchdog has led the output to rest, tells the set-point and not the output; and
        where nobody knows what it has after power-on, so may any other. One that was given its safe value last rests
        where the watchdog does not say it: so a person's word is asked for once.
        """
        unknown, values = [], list(values)
        still = watchdog is not None and watchdog.ms is not None and silent_ns >= watchdog.still_ns
        for i, output in enumerate(self._outputs):
            if output.kind != VOLTAGE:
                continue
            self._led[i] = self._led[i] or still
            if self._led[i] and self._may_be_a_set_point(i, values[i], watchdog):
                values[i] = None
            if values[i] is not None:
                continue
            given = (self._lowest[i], self._highest[i]) if self._known[i] else UNKNOWN
            low, high = after_silence(watchdog, silent_ns, given, self._rests_at[i])
            if low == high and (low, high) != given:
                self._begin_at(i, low)
            elif math.isfinite(low) and math.isfinite(high):
                self._lowest[i], self._highest[i] = low, high
            elif not self._known[i] or not self._is_near(i, output.safe):
                unknown.append(i)
                continue
            if (low, high) != given and self._is_near(
                i, output.safe
            ):  # from what it was given, one at rest would leave it
                self._last[i] = self._start[i] = output.safe
        self.read_back(values)
        return unknown

    def _may_be_a_set_point(self, i: int, value: float | None, watchdog: Watchdog | None) -> bool:
        """Whether what output `i` reads may be left from before its watchdog led it to rest."""
        if value is None:
            return False
        if watchdog is None or not watchdog.leads_to_rest:
            return abs(value - self._rests_at[i]) > self._steps[i] + _EQUAL_V
        low, high = self._sent[i]
        return math.isfinite(low) and low - self._steps[i] <= value <= high + self._steps[i]

    def assume_safe(self, *, where_unknown: bool = False) -> None:
        """Take the voltages, `where_unknown` those of which nothing is known, for being at their safe values."""
        for i, output in enumerate(self._outputs):
            if output.kind == VOLTAGE and not (where_unknown and self._known[i]):
                self._begin_at(i, output.safe)

    def is_near_rest(self, indices: Sequence[int] | None = None) -> bool:
        """Whether it makes no step where the device's watchdog leads the voltages among `indices` (None: all)."""
        chosen = range(len(self._outputs)) if indices is None else indices
        return all(
            self._outputs[i].kind != VOLTAGE or (self._known[i] and self._is_near(i, self._rests_at[i])) for i in chosen
        )

    def all_told(self, values: Known) -> bool:
        """Whether `values` has every voltage."""
        pairs = zip(values, self._outputs, strict=True)
        return all(value is not None or output.kind != VOLTAGE for value, output in pairs)

    def _is_near(self, i: int, value: float) -> bool:
        furthest = max(abs(self._lowest[i] - value), abs(self._highest[i] - value))
        return furthest <= self._steps[i] + _EQUAL_V

    def _begin_at(self, i: int, value: float) -> None:
        output = self._outputs[i]
        self._known[i] = True
        self._last[i] = min(max(value, output.low), output.high)
        self._start[i] = self._lowest[i] = self._highest[i] = self._last[i]
        self._share[i] = 0.0

    def leave(self) -> None:
        """The device is not in the loop's hand any more, and what it has is not known to be at rest."""
        if self.state != SAFE_RAMP:
            self.state, self._start = SAFE_RAMP, list(self._last)
            self._share = [0.0] * len(self._share)
        self._given = [False] * len(self._given)
        self._rest_if_given()

    def is_dead(self, written_ns: int, now_ns: int) -> bool:
        """Whether the loop, which wrote last at `written_ns`, has been silent for too long."""
        return now_ns - written_ns > self._dead_ns

    def values(self, wanted: Values, written_ns: int, now_ns: int) -> list[float]:
        """What the device is to be given next, where the loop wanted `wanted` at `written_ns`.

        Tell what came of it: `given`, `attempted`, or neither where it was held back.
        """
        dead = self.is_dead(written_ns, now_ns)
        if dead and self.state == FOLLOWING:
            self.leave()
        if self.state == RESTING and not dead and self._asks_for_rest(wanted):
            self.state = FOLLOWING
        values = self._wanted(wanted) if self.state == FOLLOWING else self._on_the_way()
        for i, output in enumerate(self._outputs):
            if output.kind == VOLTAGE:
                values[i] = self._gated(i, values[i])
        return values

    def given(self, indices: Sequence[int], values: Values) -> None:
        """The device has taken `values` of these outputs, as far as its protocol can tell."""
        for i in indices:
            self._last[i] = self._lowest[i] = self._highest[i] = values[i]
            self._sent[i], self._led[i] = (values[i], values[i]), False
            self._known[i] = self._given[i] = True
            if self.state == SAFE_RAMP:
                self._share[i] += self._periods_s[i] / self._ramp_s
        self._rest_if_given()

    def attempted(self, indices: Sequence[int], values: Values) -> None:
        """It is not known whether the device has taken `values` of these outputs."""
        for i in indices:
            self._lowest[i], self._highest[i] = min(self._lowest[i], values[i]), max(self._highest[i], values[i])
            low, high = self._sent[i]
            self._sent[i] = (min(low, values[i]), max(high, values[i])) if math.isfinite(low) else (values[i],) * 2

    def lend(self, steady: Any) -> None:
        """Let the compiled loop go on from here, where the outputs follow or rest: `steady` is a STEADY record."""
        steady["dead_ns"] = self._dead_ns
        for i, (output, row) in enumerate(zip(self._outputs, steady["output"], strict=False)):
            row["kind"] = _COMPILED_KINDS[output.kind]
            row["safe"], row["low"], row["high"], row["step"] = output.safe, output.low, output.high, self._steps[i]
            row["last"], row["lowest"], row["highest"] = self._last[i], self._lowest[i], self._highest[i]
            row["rest"] = self._rests_at[i]
        steady["noted"][: len(self._outputs)] = self.last

    def take_back(self, steady: Any, given: Sequence[int]) -> None:
        """Go on from where the compiled loop is; `given` are the outputs that the device has taken meanwhile."""
        rows, before = steady["output"][: len(self._outputs)], [*zip(self._lowest, self._highest, strict=True)]
        self._last, self._lowest, self._highest = (rows[name].tolist() for name in ("last", "lowest", "highest"))
        for i, now in enumerate(zip(self._lowest, self._highest, strict=True)):
            if i in given or now != before[i]:
                self._sent[i] = now
        for i in given:
            self._known[i] = self._given[i] = True
            self._led[i] = False

    @property
    def last(self) -> list[float]:
        """What the device was given last; NaN where nobody knows."""
        return [last if known else math.nan for last, known in zip(self._last, self._known, strict=True)]

    @property
    def unsafe(self) -> list[int]:
        """Outputs of which it is not known that they are at rest."""
        return [i for i in range(len(self._outputs)) if not self._rests(i)]

    def rests_with(self, values: Values) -> bool:
        """Whether the device is known to have the safe value of every voltage, and `values` leave it there."""
        voltages = [i for i, output in enumerate(self._outputs) if output.kind == VOLTAGE]
        return all(self._rests(i) and abs(values[i] - self._outputs[i].safe) <= _EQUAL_V for i in voltages)

    def outside(self, values: Known) -> list[int]:
        """Which of these values no device may have: they are outside of the outputs' ranges."""
        pairs = enumerate(zip(values, self._outputs, strict=True))
        return [i for i, (value, output) in pairs if value is not None and not output.low <= value <= output.high]

    def _gated(self, i: int, value: float) -> float:
        """`value`, or what comes nearest to it in range and within a step of all that the device may have."""
        output, step = self._outputs[i], self._steps[i]
        near = min(max(value, self._highest[i] - step), self._lowest[i] + step)
        return min(max(near, output.low), output.high)

    def _rest_if_given(self) -> None:
        if self.state == SAFE_RAMP and all(self._rests(i) for i in range(len(self._outputs))):
            self.state = RESTING

    def _rests(self, i: int) -> bool:
        """Whether the device was given the safe value since it left the loop's hand, and nothing else after that."""
        output = self._outputs[i]
        furthest = max(abs(self._lowest[i] - output.safe), abs(self._highest[i] - output.safe))
        return output.kind == UNUSED or (self._given[i] and furthest <= _EQUAL_V)

    def _asks_for_rest(self, wanted: Values) -> bool:
        return all(
            abs(wanted[i] - output.safe) <= _EQUAL_V for i, output in enumerate(self._outputs) if output.kind == VOLTAGE
        )

    def _wanted(self, wanted: Values) -> list[float]:
        values = list(self._last)
        for i, output in enumerate(self._outputs):
            if output.kind == UNUSED:
                values[i] = output.safe
            elif math.isfinite(wanted[i]) and output.low <= wanted[i] <= output.high:
                values[i] = wanted[i]
            else:
                self.refused += 1
        return values

    def _on_the_way(self) -> list[float]:
        """The next values of the ramp, a period further than those that the device was given last."""
        moving = any(output.kind == VOLTAGE and not self._rests(i) for i, output in enumerate(self._outputs))
        values = list(self._last)
        for i, output in enumerate(self._outputs):
            if output.kind == VOLTAGE:
                share = self._share[i] + self._periods_s[i] / self._ramp_s
                values[i] = self._start[i] + minimum_jerk(share) * (output.safe - self._start[i])
            elif output.kind != LAST_SWITCH or not moving:
                values[i] = output.safe
        return values
