"""What the worker of a bus does: opens the driver, does its tasks in time, keeps the outputs safe, comes back."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

from micromanip.errors import PermissionDenied
from micromanip.rt.bus_image import (
    ALIVE_NS,
    AT_REST,
    EPOCH,
    LINK,
    LINK_DOWN,
    LINK_LATCHED,
    LINK_UP,
    OUTPUT_STATE,
    RESTING,
    SAFE_RAMP,
    UNKNOWN,
)

from .backoff import BackOff, Patience
from .beginning import begin, opened
from .driver import BusDriver, Outcome
from .errors import (
    BusError,
    IdentityMismatch,
    LinkError,
    OutputRefused,
    OutputsUnknown,
    PartMissing,
    StillOpening,
    TransientError,
)
from .image import ProcessImage
from .inbox import Inbox
from .last_given import LastGiven
from .report import Report, tell
from .safe_state import OutputWriter, SafeOutput, SafeState, Values
from .schedule import Schedule, WayToRest
from .steady import SteadyService

LOOK_NS = 1_000_000
"""The worker looks whether the loop still lives so often at most; five times while that is in doubt."""
_HELD_NS, _HELD_PERIODS = 300_000_000, 20
"""Values of a task that were held back for so long, and so many of its periods, are a lost link."""
_TELL_S = 1.0
_UNREACHED_S = 30.0
"""With nobody left, a device that can't be reached is given up after so long."""


@dataclass(frozen=True)
class Rules:
    """What may be changed while the worker runs."""

    outputs: Sequence[SafeOutput]
    ramp_s: float
    dead_ns: int
    """A loop that is silent for longer is dead."""
    patience_ns: int
    """Errors that come and go are put up with for so long before the link counts as lost."""

    @property
    def look_ns(self) -> int:
        """With nothing to do, the worker looks after the loop so often."""
        return max(LOOK_NS, min(self.dead_ns, self.patience_ns) // 5)


class Worker:
    """Serves one driver until it is told to end."""

    def __init__(
        self,
        driver: BusDriver,
        image: ProcessImage,
        rules: Rules,
        memory: LastGiven | None = None,
        while_opening: Callable[[], AbstractContextManager[None]] = nullcontext,
        *,
        simulated: bool = False,
    ) -> None:
        """What the device was given is noted in `memory` too; the driver is opened inside of `while_opening`.

        A `simulated` device that nobody knows anything of counts as one at its safe values.
        """
        self._driver, self._image, self._memory, self._while_opening = driver, image, memory, while_opening
        tasks, count = driver.tasks, len(rules.outputs)
        self._rules, self._next_rules = rules, rules
        self.safe = SafeState(
            rules.outputs,
            tasks,
            rules.ramp_s,
            rules.dead_ns,
            [channel.safe for channel in driver.outputs],
            math.inf if driver.silence is None else driver.silence.begins_ns,
        )
        # the image's are of this very run, and hold wherever the device has come back; so they have the last word
        for known in (memory.read() if memory is not None else None, image.known(count)):
            if known is not None:
                self.safe.remember(known)
        if simulated:
            self.safe.assume_safe(where_unknown=True)
        self._writer = OutputWriter(driver, self.safe, self._note_given)
        self._inbox = Inbox()
        self._schedule = Schedule((), 0)
        self._way = WayToRest(tasks, rules.outputs)
        self._held_since_ns: dict[int, int] = {}
        self._reads_back = True
        """Whether to ask what the outputs have; not again, where it breaks the link, before they are at rest."""
        self._patience = Patience()
        self._opening_told_s = 0.0
        self._down_ns = time.monotonic_ns()
        self._report = Report()
        self._counts = self._report.counts
        self._ends = threading.Event()
        self._steady: SteadyService | None = None

    def end(self) -> None:
        """Come to an end: as soon as the loop is silent and the outputs are at rest."""
        self._ends.set()
        self._ask_back()

    def adopt(self, rules: Rules) -> None:
        """Go by these rules from the next turn on; may be called from another thread."""
        self._next_rules = rules
        self._ask_back()

    def _ask_back(self) -> None:
        """Have the compiled loop, which looks at nothing of this, return."""
        if self._steady is not None:
            self._steady.ask_back()

    def run(self) -> None:
        """Keep the link up; returns when it is to end, raises what is a bug."""
        with self._while_opening():
            self._steady = SteadyService.of(self._driver, self._image)
        self._keep_up(BackOff().lost)

    def _keep_up(self, wait_after_s: Callable[[float], float]) -> None:
        """Open the link again and again until it is to end; `wait_after_s` says when, of how long it held."""
        self._image.tell(ALIVE_NS, time.monotonic_ns())
        while not self._may_leave():
            opened = time.monotonic()
            try:
                self._serve()
            except (IdentityMismatch, OutputsUnknown) as problem:
                self._tell("latched", str(problem))  # before the state: who sees that must find the reason
                self._lose(LINK_LATCHED)
                self._wait(math.inf)
            except BusError as problem:
                self._way.failed(None)
                wait_s = wait_after_s(time.monotonic() - opened)
                self._tell("lost", str(problem), retry_s=round(wait_s, 3))
                self._lose(LINK_DOWN)
                self._wait(wait_s)
            finally:
                self._driver.close()

    def _serve(self) -> None:
        """One life of the link: until an error, or the end."""
        self._opening_told_s = 0.0
        missing: PartMissing | None = None
        with self._while_opening():
            try:
                if not opened(self._driver, self._goes_on_opening):
                    return
            except PartMissing as problem:
                missing = problem
            self._follow()
            self._read_back()
        self._writer.forget()
        self._patience = Patience()
        self._inbox.clear()
        self._held_since_ns.clear()
        self._schedule = Schedule(self._driver.tasks, time.monotonic_ns())
        self._counts["links"] += 1
        if missing is not None:
            self._rest_others(missing)
        self._image.tell(ALIVE_NS, time.monotonic_ns())
        self._image.tell(EPOCH, self._image.ask(EPOCH) + 1)
        self._image.tell(OUTPUT_STATE, self.safe.state)
        self._image.tell(AT_REST, 0)
        self._image.tell(LINK, LINK_UP)
        self._tell("up", self._driver.device)
        while not self._may_leave():
            self._turn(left_over=self._serve_steadily())
        self._part()

    def _rest_others(self, missing: PartMissing) -> None:
        """Bring to rest what is there; the link is not up with it.

        Raises `missing` where it is not to end then, or what comes before.
        """
        for number in missing.tasks:
            self._failed(number, missing, broke=True)
        while self._way.open_tasks(self.safe.unsafe) - missing.tasks and not self._gives_up():
            self._turn()
        if not self._may_leave():
            raise missing

    def _gives_up(self) -> bool:
        """Whether nothing is to be hoped for: a worker hopes on."""
        return False

    def _goes_on_opening(self, problem: StillOpening, for_s: float) -> bool:
        """Look after everything else while it takes its time, and tell the host each second; False to give it up."""
        self._image.tell(ALIVE_NS, time.monotonic_ns())
        if for_s >= self._opening_told_s + _TELL_S:
            self._opening_told_s = for_s
            self._tell("opening", str(problem))
        return not self._may_leave()

    def _follow(self) -> None:
        """Remember what the device is given where it is now: a port that was replugged may have got another path."""
        if self._memory is not None:
            names = [channel.name for channel in self._driver.outputs]
            try:
                self._memory = self._memory.follow(self._driver.device, names, self.safe.last)
            except PermissionDenied as problem:
                self._tell("rights", str(problem))

    def _read_back(self) -> None:
        """Begin where the device is. Raises OutputsUnknown where nobody knows that."""
        values = begin(self._driver, self.safe, self._writer, self._is_alive, self._read_outputs)
        for i in self.safe.outside(values):
            self._tell("outputs", f"{self._driver.outputs[i].name} reads {values[i]:g}, which is outside of its range")

    def _read_outputs(self) -> Sequence[float | None]:
        if not self._reads_back and not any(map(math.isnan, self.safe.last)):
            return [None] * len(self._driver.outputs)
        self._reads_back = False
        values = self._driver.read_outputs()
        self._reads_back = True
        return values

    def _is_alive(self) -> None:
        self._image.tell(ALIVE_NS, time.monotonic_ns())

    def _part(self) -> None:
        """Leave the device with the safe values: every task is tried, each failure is told."""
        self._decide(time.monotonic_ns())
        for number, task in enumerate(self._driver.tasks):
            if task.outputs:
                try:
                    self._perform(number)
                except BusError as problem:
                    self._tell("unsafe", f"{task.name} was not given its safe values once more: {problem}")

    def _serve_steadily(self) -> bool:
        """Leave the turns to the compiled loop, if there is one, until it needs one of Python's: is that to listen?"""
        if (steady := self._steady) is None or self.safe.state == SAFE_RAMP:
            return False
        steady.begin()
        if self._ends.is_set() or self._next_rules is not self._rules:
            return False
        until_ns = self._report.due_ns
        counts, left_over = steady.serve(self.safe, self._schedule, self._memory, self._rules.look_ns, until_ns)
        for name in ("performed", "received", "lost"):
            self._counts[name] += counts[name]
        if counts["calls"]:
            self._patience.note(False, counts["calls"], time.monotonic_ns())
        return left_over

    def _turn(self, *, left_over: bool = False) -> None:
        """Do what is due, or listen for a moment; hand over what came. With `left_over` no task keeps it from that."""
        now_ns = time.monotonic_ns()
        waiting = self._waiting()
        task = None if left_over else self._schedule.take(now_ns, waiting)
        if task is not None or now_ns - self.safe.decided_ns >= self._rules.look_ns:
            self._decide(now_ns)
        failed = False
        try:
            if task is not None:
                self._perform(task)
            else:
                due_ns = self._schedule.next_ns()
                look_ns = now_ns + self._rules.look_ns
                self._driver.receive(self._inbox, look_ns if due_ns is None else min(due_ns, look_ns))
        except (TransientError, OutputRefused) as problem:
            failed = True
            self._counts["errors"] += 1
            self._schedule.failed(self._failed(task, problem))
            self._patience.judge(problem, self._rules.patience_ns)
        except BusError as problem:
            self._failed(task, problem, broke=True)
            raise
        if task is not None or failed or len(self._inbox) > 0:
            self._patience.note(failed, 1, now_ns)
        self._hand_over()
        self._image.tell(ALIVE_NS, time.monotonic_ns())
        self._tell_counts(now_ns)

    def _waiting(self) -> set[int]:
        """Tasks that have no turn now."""
        if self.safe.state == SAFE_RAMP:
            return self._way.waiting(self.safe.unsafe)
        self._way.arrived()
        self._reads_back = True
        return set()

    def _tell(self, event: str, text: str, **more: Any) -> None:
        """Something has happened that others should know."""
        tell(event, text, **more)

    def _failed(self, task: int | None, problem: BusError, *, broke: bool = False) -> int | None:
        """What was done, or is meant by the driver, has failed, and the link is lost with it where it `broke`."""
        number = task if problem.task is None else problem.task
        self._way.failed(number, broke=broke)
        return number

    def _went_well(self, number: int) -> None:
        self._way.went_well(number)

    def _perform(self, number: int) -> None:
        """Do a task with what was decided. Raises what the driver does."""
        outcome = self._writer.perform(number, self._inbox)
        if outcome is Outcome.HELD:
            self._counts["held"] += 1
            self._hold(number, time.monotonic_ns())
            return
        self._held_since_ns.pop(number, None)
        if outcome is None:
            self._went_well(number)
        self._counts["performed"] += 1
        self._image.tell_turn(self._driver.tasks[number].outputs, time.monotonic_ns())

    def _hold(self, number: int, now_ns: int) -> None:
        """Nothing was sent. Raises LinkError where that has lasted for too long."""
        task = self._driver.tasks[number]
        self._schedule.held(number, now_ns)
        held_ns = now_ns - self._held_since_ns.setdefault(number, now_ns)
        if task.outputs and held_ns > max(_HELD_NS, _HELD_PERIODS * 1e9 / task.rate_hz):
            raise LinkError(
                f"{task.name} was held back for {held_ns * 1e-6:.0f} ms: an answer of before is still missing"
            )

    def _note_given(self, last: Values) -> None:
        """The device has taken something: `last` is what its outputs were given."""
        self._image.remember_sent(last, time.monotonic_ns())
        if self._memory is not None:
            self._memory.write(last)
        if self.safe.state != self._image.ask(OUTPUT_STATE):
            self._image.tell(OUTPUT_STATE, self.safe.state)

    def _hand_over(self) -> None:
        for number in self._writer.take_confirmed(self._inbox):
            self._went_well(number)
        for text in self._inbox.remarks:
            self._tell("device", text)
        self._counts["received"] += len(self._inbox)
        self._counts["lost"] += self._inbox.lost
        self._image.publish(self._inbox)

    def _decide(self, now_ns: int) -> None:
        """What the device is to be given next, by the rules that are in force now."""
        if self._next_rules is not self._rules:
            self._rules = self._next_rules
            self.safe.adopt(self._rules.outputs, self._rules.ramp_s, self._rules.dead_ns)
        wanted, written_ns = self._image.wanted()
        was = self.safe.state
        self.safe.decide(wanted[: len(self._rules.outputs)].tolist(), written_ns, now_ns)
        self._image.tell(AT_REST, int(self.safe.rests))  # before anything else is sent
        if self.safe.state != was:
            self._image.tell(OUTPUT_STATE, self.safe.state)

    def _lose(self, link: int) -> None:
        self._down_ns = time.monotonic_ns()
        self._image.tell(LINK, link)
        self.safe.leave()
        self._image.tell(OUTPUT_STATE, UNKNOWN)

    def _wait(self, seconds: float) -> None:
        """Let time pass without a link."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not self._may_leave():
            now_ns = time.monotonic_ns()
            self._image.tell(ALIVE_NS, now_ns)
            self._tell_counts(now_ns)
            time.sleep(min(0.005, max(0.0, end - time.monotonic())))

    def _may_leave(self) -> bool:
        """Whether it is to end, the loop is silent, and the outputs are at rest, or were never or long not reached."""
        if not self._ends.is_set():
            return False
        _, written_ns = self._image.wanted()
        now_ns = time.monotonic_ns()
        if not self.safe.is_dead(written_ns, now_ns):
            return False
        if self.safe.state == RESTING or not self._counts["links"]:
            return True
        return self._image.ask(LINK) != LINK_UP and now_ns - self._down_ns > _UNREACHED_S * 1e9

    def _tell_counts(self, now_ns: int) -> None:
        if now_ns >= self._report.due_ns:
            self._counts["refused"], self._counts["skipped"] = self.safe.refused, self._schedule.skipped
            self._report.tell_counts(now_ns, self._driver.statistics())
