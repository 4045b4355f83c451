"""The way of every value to a device of a bus: through the gate, and what became of it is noted."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from .driver import BusDriver, Outcome
from .errors import OutputRefused
from .inbox import Inbox
from .safe_state import SafeState, Values


class OutputWriter:
    """Does the tasks of a driver with what its gate lets through."""

    def __init__(self, driver: BusDriver, safe: SafeState, noted: Callable[[Sequence[float]], None]) -> None:
        """`noted` gets what the outputs were given last (NaN: nobody knows) whenever the device has taken something."""
        self._driver, self._safe, self._noted = driver, safe, noted
        self._sent: dict[int, Values] = {}
        """Values of each task that the device has not confirmed yet."""
        self.taken_s: dict[int, float] = {}
        """When the device took the outputs of each task last (time.monotonic)."""

    def perform(self, number: int, values: Values, inbox: Inbox) -> Outcome | None:
        """Do task `number` with `values` of the gate, and tell the gate what became of them.

        Returns what the driver does, raises what it does.
        """
        outputs = self._driver.tasks[number].outputs
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
            row["unconfirmed"] = number in self._sent
            if number in self._sent:
                row["sent"][: len(self._sent[number])] = self._sent[number]

    def take_back(self, rows: Any) -> None:
        """Go on from where the compiled loop is."""
        count = len(self._driver.outputs)
        tasks = enumerate(rows[: len(self._driver.tasks)])
        self._sent = {number: row["sent"][:count].tolist() for number, row in tasks if row["unconfirmed"]}

    def forget(self) -> None:
        """What was sent over a link that is gone is not confirmed any more."""
        self._sent.clear()

    def _send(self, number: int, values: Values) -> None:
        self._safe.attempted(self._driver.tasks[number].outputs, values)
        self._sent[number] = values

    def _give(self, number: int, values: Values) -> None:
        self._safe.given(self._driver.tasks[number].outputs, values)
        self.taken_s[number] = time.monotonic()
        self._noted(self._safe.last)
