"""An open driver, called as the worker calls it: tasks at their rates, ``receive`` in between."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from micromanip.bus.driver import BusDriver, Outcome
from micromanip.bus.errors import BusError, LinkError, StillOpening
from micromanip.bus.inbox import Inbox, Sample

_SLICE_NS = 5_000_000
_OPEN_S = 10.0
_STREAM_S = 0.25
"""Several times what a driver that is quiet needs to show it: what was under way has come by then, too."""

TRIES = 3
"""A busy machine holds a device up now and then; a driver that is wrong fails each time."""
TURNS_AFTER_SILENCE = 2
"""A silence may end just before the link is lost by it: then that is seen in the first turn, and all is well in the
next."""


@dataclass(frozen=True)
class Arrival:
    """A sample, and when it was handed over (CLOCK_MONOTONIC)."""

    sample: Sample
    handed_ns: int


def guarded(call: Callable[[], object], doing: str) -> BusError | None:
    """Do it; the bus error that it raised, None if it raised none. Anything else that it raises is a bug."""
    try:
        call()
    except BusError as error:
        return error
    except Exception as error:
        raise AssertionError(
            f"{doing} raised {type(error).__name__}: {error}; only errors of bus_errors.py may leave a driver"
        ) from error
    return None


class Session:
    """A driver between ``open`` and ``close``; collects what it receives and the errors that it raises."""

    def __init__(self, driver: BusDriver) -> None:
        self.driver = driver
        self.arrivals: list[Arrival] = []
        self.errors: list[BusError] = []
        self.confirmed: list[int] = []
        """Tasks whose outputs the device has confirmed."""
        self.outcome: Outcome | None = None
        """Of the newest write."""
        self.inputs = [channel.name for channel in driver.inputs]
        self.values: list[float] = [channel.safe for channel in driver.outputs]
        self._inbox = Inbox()
        self._due_ns: list[int] = []

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.driver.close()

    def open(self) -> None:
        """Open the driver; a device that is there and refused is a failure."""
        for left in reversed(range(TRIES)):
            error = self._opened()
            if left == 0 or not isinstance(error, LinkError):
                break
            self.driver.close()
        assert error is None, f"open raised {type(error).__name__} with the device there: {error}"

    def _opened(self) -> BusError | None:
        """What came of opening, as long as the driver says that it goes on."""
        end = time.monotonic() + _OPEN_S
        while True:
            error = guarded(self.driver.open, "open")
            if not isinstance(error, StillOpening) or time.monotonic() > end:
                return error
            time.sleep(_SLICE_NS * 1e-9)

    def perform(self, task: int, values: Sequence[float] | None = None) -> BusError | None:
        """Do one task with `values`, or those of the session."""
        chosen = self.values if values is None else list(values)

        def perform() -> None:
            self.outcome = self.driver.perform(task, chosen, self._inbox)

        error = self._note(guarded(perform, f"perform of task {task}"))
        known = self.outcome is None or isinstance(self.outcome, Outcome)
        assert known, f"perform of task {task} returned {self.outcome!r}, which is neither None nor an Outcome"
        return error

    def perform_all(self, values: Sequence[float] | None = None) -> list[BusError]:
        """Do every task once; what they raised."""
        done = [self.perform(task, values) for task in range(len(self.driver.tasks))]
        return [error for error in done if error is not None]

    def receive(self, seconds: float) -> BusError | None:
        """Receive once, for so long at most; a negative time is one that has passed."""
        until_ns = time.monotonic_ns() + int(seconds * 1e9)
        return self._note(guarded(lambda: self.driver.receive(self._inbox, until_ns), "receive"))

    def run(self, seconds: float, enough: Callable[[], bool] = lambda: False) -> bool:
        """Call it as the worker does, for so long or until `enough`; True if that was reached.

        Periods that were missed are skipped. After a lost link it ends at once.
        """
        end_ns = time.monotonic_ns() + int(seconds * 1e9)
        self._due_ns = [time.monotonic_ns()] * len(self.driver.tasks)
        first = len(self.errors)
        while (now_ns := time.monotonic_ns()) < end_ns:
            self._perform_due(now_ns)
            until_ns = min([*self._due_ns, end_ns, time.monotonic_ns() + _SLICE_NS])
            self.receive((until_ns - time.monotonic_ns()) * 1e-9)
            if enough():
                return True
            if any(isinstance(error, LinkError) for error in self.errors[first:]):
                return False
        return False

    @property
    def is_lost(self) -> bool:
        """Whether the driver has said that the link is lost, among the errors that are not forgotten."""
        return any(isinstance(error, LinkError) for error in self.errors)

    def open_again_if_lost(self) -> None:
        """Close and open the driver where the link is lost; its errors are forgotten then."""
        if self.is_lost:
            self.driver.close()
            self.open()
            self.errors.clear()

    def fresh(self, seconds: float = 1.0) -> bool:
        """Run until every input has a new good sample, for so long at most."""
        self.forget()
        return self.run(seconds, lambda: self.good() >= set(self.inputs))

    def good(self) -> set[str]:
        """Inputs of which a good sample was handed over."""
        return {self.inputs[one.sample.channel] for one in self.arrivals if one.sample.status == 0}

    def forget(self) -> None:
        """Forget samples and errors up to now."""
        self.arrivals.clear()
        self.errors.clear()

    def drain(self, quiet_s: float = 0.05) -> None:
        """Take what is still under way, until nothing came for so long, and forget it.

        A device that sends by itself is never quiet: it is listened to for no more than `_STREAM_S`.
        """
        end = quiet_end = time.monotonic()
        end, quiet_end = end + _STREAM_S, quiet_end + quiet_s
        while time.monotonic() < min(end, quiet_end):
            before = len(self.arrivals)
            self.receive(0.005)
            if len(self.arrivals) > before:
                quiet_end = time.monotonic() + quiet_s
        self.forget()

    def _perform_due(self, now_ns: int) -> None:
        for number, task in enumerate(self.driver.tasks):
            period_ns = round(1e9 / task.rate_hz)
            if now_ns >= self._due_ns[number]:
                self._due_ns[number] += period_ns * (1 + (now_ns - self._due_ns[number]) // period_ns)
                self.perform(number)

    def _note(self, error: BusError | None) -> BusError | None:
        now_ns = time.monotonic_ns()
        self.arrivals += [Arrival(sample, now_ns) for sample in self._inbox]
        self.confirmed += self._inbox.take_confirmed()
        self._inbox.clear()
        if error is not None:
            self.errors.append(error)
        return error
