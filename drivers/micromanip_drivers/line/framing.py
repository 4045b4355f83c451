"""What a framing does for the driver: it knows the channels, and what their values are on the port."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence

from micromanip.driver import Answer, Channel, Inbox, Load, Outcome, Task


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

    @abstractmethod
    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> Outcome | None:
        """As ``BusDriver.perform``."""

    def read_outputs(self) -> Sequence[float | None]:
        """As ``BusDriver.read_outputs``."""
        return [None] * len(self.outputs)

    @abstractmethod
    def receive(self, inbox: Inbox, until_ns: int) -> None:
        """As ``BusDriver.receive``."""

    @abstractmethod
    def probe(self, seconds: float) -> Iterator[Answer]:
        """What answers, and what it says; nothing is moved."""

    @property
    @abstractmethod
    def counters(self) -> Mapping[str, int]:
        """Of its own, since it was built; they only rise."""
