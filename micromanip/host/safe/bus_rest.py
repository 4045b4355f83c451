"""The outputs of one bus brought to rest without a worker and without a loop."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

from micromanip.bus.beginning import begin, opened
from micromanip.bus.driver import BusDriver, Outcome
from micromanip.bus.errors import (
    BusError,
    IdentityMismatch,
    LinkError,
    OutputRefused,
    OutputsUnknown,
    PartMissing,
    TransientError,
)
from micromanip.bus.inbox import Inbox
from micromanip.bus.last_given import LastGiven
from micromanip.bus.output_writer import OutputWriter
from micromanip.bus.safe_state import LAST_SWITCH, VOLTAGE, SafeOutput, SafeState
from micromanip.bus.schedule import Schedule, WayToRest
from micromanip.errors import PermissionDenied
from micromanip.rt.bus_image import RESTING

PATIENCE_S, _TURNS = 3.0, 2
"""A task whose outputs the device has not taken for so long, and so many turns, is given up."""
_SPARE_S = 10.0
"""Time beside that of ramp and slew, for links that come and go."""
_AGAIN_S, _LOOK_NS = 0.05, 20_000_000
_VERIFY_S, _VERIFY_SHARE = 0.5, 0.01
"""So long after the last write a device may take to read back the safe value, to within this share of the range."""


class BusRest:
    """The way of a bus' outputs to their safe values."""

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
        self._at_rest, self._simulated = at_rest, simulated
        self._bus, self._outputs = bus, outputs
        self._way = WayToRest(bus.tasks, outputs)
        self._way.failed(None)  # whatever it reads is nobody's here
        self._task_of = self._way.task_of
        rests = [channel.safe for channel in bus.outputs]
        begins_ns = math.inf if bus.silence is None else bus.silence.begins_ns
        self._safe = SafeState(outputs, bus.tasks, ramp_s, 0, rests, begins_ns)
        self._writer = OutputWriter(bus, self._safe, self._note)
        self._inbox = Inbox()
        self._memory: LastGiven | None = None
        self._problems: dict[int, str] = {}
        self._begun_s: float
        self._nearer_s, self._furthest_V = math.inf, math.inf
        """When the voltages were last nearer to rest than ever before: a host may be slow, and the way long."""
        self._since_s: dict[int, float] = {}
        """When each task was passed over last."""
        self._reads_back = False
        self._asks = True
        """Whether to ask what the outputs have; not again where it breaks the link and something is known."""
        slowest_s = max((_span(each) / each.slew_V_per_s for each in outputs if each.kind == VOLTAGE), default=0.0)
        ways = len({self._task_of[i] for i, each in enumerate(outputs) if each.kind == VOLTAGE})  # one after the other
        self._longest_s = max(1, ways) * (ramp_s + slowest_s) + _SPARE_S
        self.notes: list[str] = []
        """What should be known, and is no failure."""

    def run(self) -> list[str]:
        """Bring them to rest; what is not known to be there, and why, a line each."""
        self._recall()
        if self._at_rest or self._simulated:
            self._safe.assume_safe(where_unknown=not self._at_rest)
        self._begun_s = self._nearer_s = time.monotonic()
        problem: BusError | None = None
        try:
            while not self._is_over():
                try:
                    is_open, missing = self._opened()
                    if is_open:
                        self._serve(missing)
                except BusError as found:
                    problem = found
                    if isinstance(found, IdentityMismatch | OutputsUnknown):
                        break  # whatever answers, it is not ours to write to, or nobody knows what
                    time.sleep(_AGAIN_S)
                finally:
                    self._bus.close()
        finally:
            if self._memory is not None:
                self._memory.close()
        if self._safe.state == RESTING:
            return self._verified() if self._reads_back else []
        return [self._line(i, problem) for i in self._safe.unsafe]

    def _opened(self) -> tuple[bool, PartMissing | None]:
        """Whether the link is open, and what is missing where the rest of it is there. Raises BusError."""
        try:
            return opened(self._bus, lambda *_: not self._is_over()), None
        except PartMissing as problem:
            for number in problem.tasks:
                self._way.failed(number, broke=True)
            return True, problem

    def _recall(self) -> None:
        """Begin from what the outputs were given last by whoever it was."""
        try:
            self._memory = LastGiven.open(self._bus.device, [channel.name for channel in self._bus.outputs])
        except PermissionDenied as problem:
            self.notes.append(str(problem))
            return
        if (known := self._memory.read()) is not None:
            self._safe.remember(known)

    def _note(self, last: Sequence[float]) -> None:
        ways = (abs(value - each.safe) for value, each in zip(last, self._outputs, strict=True) if each.kind == VOLTAGE)
        if (furthest_V := max(ways, default=0.0)) < self._furthest_V:
            self._nearer_s, self._furthest_V = time.monotonic(), furthest_V
        if self._memory is not None:
            self._memory.write(last)

    def _read_back(self) -> None:
        values = begin(self._bus, self._safe, self._writer, lambda: None, self._read_outputs)
        self._reads_back = self._reads_back or any(value is not None for value in values)

    def _read_outputs(self) -> Sequence[float | None]:
        if not self._asks and not any(map(math.isnan, self._safe.last)):
            return [None] * len(self._outputs)
        self._asks = False
        values = self._bus.read_outputs()
        self._asks = True
        return values

    def _serve(self, missing: PartMissing | None) -> None:
        """One life of the link. Raises BusError once it is lost and every task has had its turn."""
        self._writer.forget()
        self._inbox.clear()
        self._read_back()
        self._problems.clear()
        schedule = Schedule(self._bus.tasks, time.monotonic_ns())
        gone: frozenset[int] = frozenset()
        if missing is not None:
            gone = missing.tasks
            self._problems |= dict.fromkeys(gone, str(missing))
        untried = set(self._task_of.values()) - gone
        lost: BusError | None = None
        while not self._is_over():
            if lost is not None and not untried:
                raise lost
            if missing is not None and not self._way.open_tasks(self._safe.unsafe) - gone:
                raise missing
            now_ns = time.monotonic_ns()
            number = schedule.take(now_ns, self._passed_over(now_ns, gone))
            try:
                if number is None:
                    self._listen(schedule, now_ns, lost)
                else:
                    untried.discard(number)
                    self._turn(number, now_ns, schedule)
            except (TransientError, OutputRefused) as problem:
                number = number if problem.task is None else problem.task
                self._failed(number, problem)
                self._way.failed(number)
                schedule.failed(number)
            except BusError as problem:
                number = number if problem.task is None else problem.task
                if not isinstance(lost, LinkError):  # after that, nothing new is learnt
                    self._failed(number, problem)
                if lost is None:
                    self._way.failed(number, broke=True)
                lost = lost or problem
            for number in self._writer.take_confirmed(self._inbox):
                self._went_well(number)
            self._inbox.clear()

    def _passed_over(self, now_ns: int, gone: frozenset[int]) -> set[int]:
        """Tasks that have no turn now; the time of those that wait for others has not begun."""
        waiting = self._way.waiting(self._safe.unsafe)
        for number in waiting - gone:
            self._since_s[number] = now_ns * 1e-9
        return waiting | gone

    def _turn(self, number: int, now_ns: int, schedule: Schedule) -> None:
        """Do a task. Raises BusError."""
        self._safe.decide((), 0, now_ns)  # of a loop that never was nothing is taken
        outcome = self._writer.perform(number, self._inbox)
        if outcome is None:
            self._went_well(number)
        elif outcome is Outcome.HELD:
            schedule.held(number, time.monotonic_ns())

    def _went_well(self, number: int) -> None:
        self._problems.pop(number, None)
        self._way.went_well(number)

    def _listen(self, schedule: Schedule, now_ns: int, lost: BusError | None) -> None:
        due_ns = min(schedule.next_ns() or now_ns, now_ns + _LOOK_NS)
        if lost is None:
            self._bus.receive(self._inbox, due_ns)
        else:
            time.sleep(max(0, due_ns - now_ns) * 1e-9)

    def _failed(self, number: int | None, problem: BusError) -> None:
        if number is not None:
            self._problems.setdefault(number, str(problem))

    def _is_over(self) -> bool:
        """Whether all is at rest, or nothing can be hoped for any more."""
        now_s = time.monotonic()
        if now_s - self._nearer_s > self._longest_s:
            return True
        return all(
            now_s - max(self._writer.taken_s(number), self._since_s.get(number, self._begun_s))
            > PATIENCE_S + _TURNS / self._bus.tasks[number].rate_hz
            for number in self._way.open_tasks(self._safe.unsafe)
        )

    def _verified(self) -> list[str]:
        """What the device, asked anew, has instead of what it has taken."""
        end_s = time.monotonic() + _VERIFY_S
        while True:
            try:
                opened(self._bus, lambda *_: time.monotonic() <= end_s)
                differing = [
                    f"{self._named(i)} was given and reads {value:g}{self._unit(i)}"
                    for i, value in enumerate(self._bus.read_outputs())
                    if value is not None and self._differs(i, value)
                ]
            except BusError as problem:
                differing = [f"its outputs were given their safe values, but can't be read back: {problem}"]
            finally:
                self._bus.close()
            if not differing or time.monotonic() > end_s:
                return differing
            time.sleep(_AGAIN_S)

    def _differs(self, i: int, value: float) -> bool:
        output = self._outputs[i]
        return output.kind == VOLTAGE and not abs(value - output.safe) <= _VERIFY_SHARE * _span(output)

    def _line(self, i: int, problem: BusError | None) -> str:
        last = self._safe.last[i]
        what = "nobody knows what it has" if math.isnan(last) else f"unknown, last {last:g}{self._unit(i)}"
        why = self._problems.get(self._task_of[i]) or problem or "it was not acknowledged"
        if self._outputs[i].kind == LAST_SWITCH and any(self._outputs[k].kind == VOLTAGE for k in self._safe.unsafe):
            why = "it waits for the voltages to be at rest"
        return f"{self._named(i)} can't be called safe: {what}; {why}"

    def _named(self, i: int) -> str:
        return f"{self._bus.outputs[i].name} (safe: {self._outputs[i].safe:g}{self._unit(i)})"

    def _unit(self, i: int) -> str:
        return " V" if self._outputs[i].kind == VOLTAGE else ""


def _span(output: SafeOutput) -> float:
    return output.high - output.low
