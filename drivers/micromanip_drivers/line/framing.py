"""What a framing does for the driver: it knows the channels, and their values on the port; when the port is silent."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence

from micromanip.driver import Answer, Channel, Inbox, LinkError, Load, Outcome, Steady, Task


class Framing(ABC):
    """One device on one port; the port is open when a method is called."""

    inputs: Sequence[Channel]
    outputs: Sequence[Channel]
    tasks: Sequence[Task]
    loads: Sequence[Load]
    speaks_hz: float | None = None
    """How often the device speaks by itself, at least; None for one that only answers."""

    @abstractmethod
    def begin(self, deadline_ns: int) -> None:
        """The port was opened just now: forget what was, look who answers, until `deadline_ns` at the latest.

        Raises LinkError where nobody answers, IdentityMismatch for another device than the one configured.
        """

    def end(self) -> None:  # noqa: B027 (most hold nothing)
        """The port is about to be closed; does no harm twice."""

    @abstractmethod
    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> Outcome | None:
        """As ``BusDriver.perform``."""

    def read_outputs(self) -> Sequence[float | None]:
        """As ``BusDriver.read_outputs``."""
        return [None] * len(self.outputs)

    @abstractmethod
    def receive(self, inbox: Inbox, until_ns: int) -> None:
        """As ``BusDriver.receive``."""

    def steady(self) -> Steady | None:
        """As ``BusDriver.steady``."""
        return None

    @abstractmethod
    def probe(self, seconds: float) -> Iterator[Answer]:
        """What answers, and what it says; nothing is moved."""

    @property
    @abstractmethod
    def counters(self) -> Mapping[str, int]:
        """Of its own, since it was built; they only rise."""


class Silence:
    """Watches for `limit_ms` without anything that was understood, while something is expected.

    A device that should speak and doesn't: a half-open connection, a cable that was pulled, a device that hangs.
    """

    def __init__(self, name: str, limit_ms: float) -> None:
        self._name = name
        self._limit_ns = round(limit_ms * 1e6)
        self._since_ns: int | None = None
        self._line = ""

    def misunderstood(self, line: str) -> None:
        """A line that came; it is told where nothing better does."""
        self._line = line

    @property
    def limit_ns(self) -> int:
        """So long it may be silent."""
        return self._limit_ns

    @property
    def since_ns(self) -> int:
        """When it was understood last, or should have begun to speak; 0 while nothing is expected."""
        return self._since_ns or 0

    def expect(self, now_ns: int) -> None:
        """From now on it should speak, if it should not already."""
        if self._since_ns is None:
            self._since_ns = now_ns

    def heard(self, now_ns: int, more: bool) -> None:
        """It was understood; `more`: and should speak again without being asked."""
        self._since_ns = now_ns if more else None
        self._line = ""

    def check(self, now_ns: int) -> None:
        """Raises LinkError when it has been silent for too long."""
        if self._since_ns is not None and now_ns - self._since_ns > self._limit_ns:
            came = f'; what came: "{self._line}"' if self._line else ""
            raise LinkError(f"{self._name}: nothing understood for {self._limit_ns * 1e-6:g} ms{came}")
