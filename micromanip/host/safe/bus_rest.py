"""The outputs of one bus brought to rest without a loop: by a worker that ends there, or gives up."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from micromanip.bus.beginning import opened
from micromanip.bus.driver import BusDriver
from micromanip.bus.errors import BusError, PartMissing
from micromanip.bus.image import ProcessImage
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import LAST_SWITCH, VOLTAGE, SafeOutput
from micromanip.bus.worker import Rules, Worker
from micromanip.errors import PermissionDenied
from micromanip.rt.bus_image import IMAGE, RESTING

PATIENCE_S, _TURNS = 3.0, 2
"""A task whose outputs the device has not taken for so long, and so many turns, is given up."""
_SPARE_S = 10.0
"""Time beside that of ramp and slew, for links that come and go."""
_AGAIN_S = 0.05
_VERIFY_S, _VERIFY_SHARE = 0.5, 0.01
"""So long after the last write a device may take to read back the safe value, to within this share of the range."""
_NEVER_NS = 1 << 62


class BusRest(Worker):
    """The way of a bus' outputs to their safe values: what a worker does whose loop is dead."""

    def __init__(
        self,
        bus: BusDriver,
        outputs: Sequence[SafeOutput],
        ramp_s: float,
        *,
        at_rest: bool = False,
        simulated: bool = False,
    ) -> None:
        """`outputs` are those of the driver, in its order. A person says that they are `at_rest`; a `simulated` device
        that nobody knows anything of counts as such a one.
        """
        self.notes: list[str] = []
        """What should be known, and is no failure."""
        image = np.zeros(1, IMAGE)
        image["inputs"], image["outputs"] = len(bus.inputs), len(bus.outputs)
        rules, memory = Rules(outputs, ramp_s, 0, _NEVER_NS), self._memory_of(bus)
        super().__init__(bus, ProcessImage(image), rules, memory, simulated=simulated)
        if at_rest:
            self.safe.assume_safe()
        self._way.failed(None)  # whatever it reads is nobody's here
        self._outputs = outputs
        self._problem, self._hopeless = "", False
        self._problems: dict[int, str] = {}
        self._begun_s = self._nearer_s = time.monotonic()
        self._furthest_V = math.inf
        """When the voltages were last nearer to rest than ever before: a host may be slow, and the way long."""
        self._missing: frozenset[int] = frozenset()
        self._since_s: dict[int, float] = {}
        """When each task was passed over last."""
        self._verifies = False
        """Whether the device can be asked what it has."""
        slowest_s = max((_span(each) / each.slew_V_per_s for each in outputs if each.kind == VOLTAGE), default=0.0)
        ways = len({self._way.task_of[i] for i, each in enumerate(outputs) if each.kind == VOLTAGE})
        self._longest_s = max(1, ways) * (ramp_s + slowest_s) + _SPARE_S  # one after the other

    def rest(self) -> list[str]:
        """Bring them to rest; what is not known to be there, and why, a line each."""
        try:
            self._keep_up(lambda _held_s: _AGAIN_S)
        finally:
            if self._memory is not None:
                self._memory.close()
        if self.safe.state == RESTING:
            return self._verified() if self._verifies else []
        return [self._line(i, self._problem) for i in self.safe.unsafe]

    def _memory_of(self, bus: BusDriver) -> LastGiven | None:
        """What the outputs were given last by whoever it was."""
        try:
            return LastGiven.open(bus.device, [channel.name for channel in bus.outputs])
        except PermissionDenied as problem:
            self.notes.append(str(problem))
            return None

    def _may_leave(self) -> bool:
        return self.safe.state == RESTING or self._gives_up()

    def _gives_up(self) -> bool:
        """Whether nothing can be hoped for any more; whatever is not ours to write to, or unknown, is that at once."""
        now_s = time.monotonic()
        if self._hopeless or now_s - self._nearer_s > self._longest_s:
            return True
        return all(
            now_s - max(self._writer.taken_s(number), self._since_s.get(number, self._begun_s))
            > PATIENCE_S + _TURNS / self._driver.tasks[number].rate_hz
            for number in self._way.open_tasks(self.safe.unsafe)
        )

    def _waiting(self) -> set[int]:
        """The time of those that wait for others has not begun."""
        waiting = super()._waiting()
        self._since_s |= dict.fromkeys(waiting - self._missing, time.monotonic())
        return waiting

    def _read_outputs(self) -> Sequence[float | None]:
        self._missing = frozenset()
        values = super()._read_outputs()
        self._verifies = self._verifies or any(value is not None for value in values)
        return values

    def _rest_others(self, missing: PartMissing) -> None:
        self._missing = missing.tasks
        super()._rest_others(missing)

    def _note_given(self, last: Sequence[float]) -> None:
        ways = (abs(value - each.safe) for value, each in zip(last, self._outputs, strict=True) if each.kind == VOLTAGE)
        if (furthest_V := max(ways, default=0.0)) < self._furthest_V:
            self._nearer_s, self._furthest_V = time.monotonic(), furthest_V
        super()._note_given(last)

    def _failed(self, task: int | None, problem: BusError, *, broke: bool = False) -> int | None:
        number = super()._failed(task, problem, broke=broke)
        if number is not None:
            self._problems[number] = str(problem)
        return number

    def _went_well(self, number: int) -> None:
        self._problems.pop(number, None)
        super()._went_well(number)

    def _hold(self, number: int, now_ns: int) -> None:
        """An answer that is still missing is waited for as long as any other."""
        self._schedule.held(number, now_ns)

    def _lose(self, link: int) -> None:
        """What is at rest stays so, whatever becomes of the link to the others."""

    def _part(self) -> None:
        """It was given its safe values just now."""

    def _tell(self, event: str, text: str, **_: Any) -> None:
        if event in ("latched", "lost"):
            self._problem, self._hopeless = text, event == "latched"
        elif event != "opening":
            self.notes += [text] if event != "up" else []

    def _tell_counts(self, now_ns: int) -> None:
        """Nobody counts."""

    def _verified(self) -> list[str]:
        """What the device, asked anew, has instead of what it has taken."""
        end_s = time.monotonic() + _VERIFY_S
        while True:
            try:
                opened(self._driver, lambda *_: time.monotonic() <= end_s)
                differing = [
                    f"{self._named(i)} was given and reads {value:g}{self._unit(i)}"
                    for i, value in enumerate(self._driver.read_outputs())
                    if value is not None and self._differs(i, value)
                ]
            except BusError as problem:
                differing = [f"its outputs were given their safe values, but can't be read back: {problem}"]
            finally:
                self._driver.close()
            if not differing or time.monotonic() > end_s:
                return differing
            time.sleep(_AGAIN_S)

    def _differs(self, i: int, value: float) -> bool:
        output = self._outputs[i]
        return output.kind == VOLTAGE and not abs(value - output.safe) <= _VERIFY_SHARE * _span(output)

    def _line(self, i: int, problem: str) -> str:
        last = self.safe.last[i]
        what = "nobody knows what it has" if math.isnan(last) else f"unknown, last {last:g}{self._unit(i)}"
        why = self._problems.get(self._way.task_of[i]) or problem or "it was not acknowledged"
        if self._outputs[i].kind == LAST_SWITCH and any(self._outputs[k].kind == VOLTAGE for k in self.safe.unsafe):
            why = "it waits for the voltages to be at rest"
        return f"{self._named(i)} can't be called safe: {what}; {why}"

    def _named(self, i: int) -> str:
        return f"{self._driver.outputs[i].name} (safe: {self._outputs[i].safe:g}{self._unit(i)})"

    def _unit(self, i: int) -> str:
        return " V" if self._outputs[i].kind == VOLTAGE else ""


def _span(output: SafeOutput) -> float:
    return output.high - output.low
