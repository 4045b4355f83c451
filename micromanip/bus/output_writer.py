"""The way of every value to a device of a bus: through the gate, and what became of it is noted."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

from .driver import BusDriver, Outcome
from .errors import LinkError, OutputRefused
from .inbox import Inbox
from .safe_state import SafeState, Values


class OutputWriter:
    """Does the tasks of a driver with what its gate lets through."""

    def __init__(self, driver: BusDriver, safe: SafeState, noted: Callable[[Sequence[float]], None]) -> None:
        """`noted` gets what the outputs were given last (NaN: nobody knows) whenever the device has taken something."""
        self._driver, self._safe, self._noted = driver, safe, noted
        self._sent: dict[int, Values] = {}
        """Values of each task that the device has not confirmed yet."""
        self._sent_ns: dict[int, int] = {}
        self._fed_ns: dict[int, int] = {}
        """When what the device has taken of each task last was sent: its watchdog's time runs from there, or later."""
        self._still: set[int] = set()
        """Tasks not done since the device was found still: silence moves it no further."""
        self.touched_ns = time.monotonic_ns()
        """When the device may have had a command last, at the latest; of whoever had it before, too."""
        self.taken_s: dict[int, float] = {}
        """When the device took the outputs of each task last (time.monotonic)."""

    def perform(self, number: int, values: Values, inbox: Inbox) -> Outcome | None:
        """Do task `number` with `values` of the gate, and tell the gate what became of them.

        Returns what the driver does, raises what it does; and LinkError where the device's watchdog may have moved it.
        """
        outputs = self._driver.tasks[number].outputs
        if outputs:
            self._watch(number)
            self._sent_ns[number] = time.monotonic_ns()
        try:
            outcome = self._driver.perform(number, values, inbox)
        except BaseException as problem:
            self.take_confirmed(inbox)
            if outputs and not isinstance(problem, OutputRefused):
                self._send(number, values)
            raise
        self.take_confirmed(inbox)
        if outputs and outcome is Outcome.SENT:
            self._send(number, values)
        elif outputs and outcome is not Outcome.HELD:
            self._give(number, values)
        return outcome

    def take_confirmed(self, inbox: Inbox) -> None:
        """What the device has said to have taken, as it was sent before."""
        for number in inbox.confirmed:
            if (values := self._sent.pop(number, None)) is not None:
                self._give(number, values)

    def lend(self, rows: Any) -> None:
        """Let the compiled loop go on from here: `rows` are TASK records, one for each task."""
        for number, row in enumerate(rows[: len(self._driver.tasks)]):
            row["fed_ns"], row["sent_ns"] = self._fed_ns.get(number, 0), self._sent_ns.get(number, 0)
            row["unconfirmed"] = number in self._sent
            if number in self._sent:
                row["sent"][: len(self._sent[number])] = self._sent[number]

    def take_back(self, rows: Any) -> None:
        """Go on from where the compiled loop is."""
        self.touched_ns = time.monotonic_ns()
        for number, (task, row) in enumerate(zip(self._driver.tasks, rows, strict=False)):
            if task.outputs and row["fed_ns"] > 0:
                self._fed_ns[number], self._sent_ns[number] = int(row["fed_ns"]), int(row["sent_ns"])
        count = len(self._driver.outputs)
        tasks = enumerate(rows[: len(self._driver.tasks)])
        self._sent = {number: row["sent"][:count].tolist() for number, row in tasks if row["unconfirmed"]}

    def found_still(self) -> None:
        """The device's watchdog has had its time, and what it has is known."""
        self._still = set(range(len(self._driver.tasks)))

    def is_in_doubt(self) -> bool:
        """Whether the device's watchdog may have begun to move an output."""
        return any(task.outputs and self._silent_ns(number) is None for number, task in enumerate(self._driver.tasks))

    def _silent_ns(self, number: int) -> float | None:
        """For how long the device may have had no values of a task; None where that is too long."""
        watchdog, fed_ns = self._driver.silence, self._fed_ns.get(number)
        begins_ns = math.inf if watchdog is None else watchdog.begins_ns
        silent_ns = math.inf if fed_ns is None else time.monotonic_ns() - fed_ns
        return silent_ns if silent_ns <= begins_ns else None

    def _watch(self, number: int) -> None:
        """Raise LinkError where a device that did not get values of a task in time may be anywhere between two."""
        if number in self._still:
            return
        if self._silent_ns(number) is None and not self._safe.is_near_rest(self._driver.tasks[number].outputs):
            raise LinkError(
                f"{self._driver.tasks[number].name}: the device took no values for longer than its watchdog waits "
                "(watchdog.ms): it may have gone to rest by itself"
            )

    def forget(self) -> None:
        """What was sent over a link that is gone is not confirmed any more."""
        self._sent.clear()

    def _send(self, number: int, values: Values) -> None:
        self._still.discard(number)
        self.touched_ns = time.monotonic_ns()
        self._safe.attempted(self._driver.tasks[number].outputs, values)
        self._sent[number] = values

    def _give(self, number: int, values: Values) -> None:
        self._safe.given(self._driver.tasks[number].outputs, values)
        self.taken_s[number] = time.monotonic()
        self.touched_ns = time.monotonic_ns()
        self._fed_ns[number] = self._sent_ns[number]
        self._still.discard(number)
        self._noted(self._safe.last)
