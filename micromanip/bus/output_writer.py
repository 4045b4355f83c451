"""The way of every value to a device of a bus: through the gate, and what became of it is noted."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from micromanip.rt.io import gate as law
from micromanip.rt.jit import plain

from .driver import BusDriver, Outcome
from .errors import LinkError, OutputRefused
from .inbox import Inbox
from .safe_state import SafeState

_may_have_moved, _note_sent, _note_taken = map(plain, (law.may_have_moved, law.note_sent, law.note_taken))


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
