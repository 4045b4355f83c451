"""What a emulated device sends by itself over and over: when it is due, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from micromanip.testbus.event_loop import EventLoop, Timer

MOST_BEHIND_NS = 5_000_000
"""A machine that is late makes up for it: messages come late, but each with its own sample and time. Beyond this they
would be too old to be of use: all up to the present are lost, which their counter shows. Lost one by one, each as soon
as it is too old, they would leave a machine that is busy so far behind for ever, and every sample too old.
"""


@dataclass
class MessageFigures:
    """Messages, since the start."""

    sent: int = 0
    received: int = 0
    not_sent: int = 0
    """Due while the machine stalled, or the queue was full."""
    not_understood: int = 0
    silent: int = 0
    """Due while it was switched off or silenced."""


@dataclass
class Due:
    """A message, and what befalls it."""

    name: str
    period_ns: int
    count: int = 0
    counts_from_ns: float = 0
    """Until then its counter stands still."""
    silent_until_ns: float = 0
    due_ns: int = 0

    def counted(self) -> int:
        """The number of the one that is sent now."""
        count = self.count
        if self.due_ns >= self.counts_from_ns:
            self.count += 1
        return count


class Periodic:
    """Calls for a message each time when it is due, also late, with the time for which it was due."""

    def __init__(
        self,
        loop: EventLoop,
        figures: MessageFigures,
        message: Due,
        advance_to: Callable[[int], None],
        send: Callable[[Due], None],
    ) -> None:
        """`advance_to` is called before each, also before those that aren't sent."""
        self._loop, self._figures, self.message = loop, figures, message
        self._advance_to, self._send = advance_to, send
        self._losing = False
        self.off_until_ns: float = 0

    def start(self, now_ns: int) -> None:
        """The first one comes a period from now."""
        self.message.due_ns = now_ns + self.message.period_ns
        self._loop.call_at(self.message.due_ns, self._is_due)

    def _is_due(self) -> None:
        message = self.message
        most_ns = min(message.period_ns, MOST_BEHIND_NS) if self._losing else MOST_BEHIND_NS
        self._losing = self._loop.now_ns() - message.due_ns > most_ns
        self._advance_to(message.due_ns)
        if message.due_ns < max(message.silent_until_ns, self.off_until_ns):
            self._figures.silent += 1
        elif self._losing:  # one after the other all the same: commands that came meanwhile act in between
            message.counted()
            self._figures.not_sent += 1
        else:
            self._send(message)
        message.due_ns += message.period_ns
        self._loop.call_at(message.due_ns, self._is_due)


class Sender:
    """A device that sends messages by itself, each of which may be silenced, or stop to count."""

    def __init__(self, loop: EventLoop) -> None:
        self.figures = MessageFigures()
        self.periodic: list[Periodic] = []
        self._loop = loop

    @property
    def messages(self) -> list[str]:
        return [periodic.message.name for periodic in self.periodic]

    def start(self, now_ns: int) -> None:
        """Begin to talk."""
        for periodic in self.periodic:
            periodic.start(now_ns)

    def stop_counter(self, message: str, for_s: float | None) -> None:
        self._message(message).counts_from_ns = self._loop.end_ns(for_s)

    def silence(self, message: str, for_s: float | None) -> None:
        self._message(message).silent_until_ns = self._loop.end_ns(for_s)

    def be_off(self, until_ns: float) -> None:
        """Send nothing until then; counters begin anew."""
        for periodic in self.periodic:
            periodic.off_until_ns = until_ns
            periodic.message.count = 0

    def clear(self) -> None:
        """Send all messages, and count them."""
        for periodic in self.periodic:
            periodic.message.silent_until_ns = periodic.message.counts_from_ns = 0

    def _message(self, name: str) -> Due:
        return next(periodic.message for periodic in self.periodic if periodic.message.name == name)


_IDLE_NS = 1_000_000
_GONE_NS = 2_000_000
"""So long after a turn was due behind a frame there is none."""


class Upkeep:
    """Calls back each millisecond; while frames come, each `served_ns`, in the pause behind one."""

    def __init__(self, loop: EventLoop, turn: Callable[[], None], served_ns: int) -> None:
        self._loop, self._turn, self._served_ns = loop, turn, served_ns
        self._looked_ns, self._serves = 0, False
        self._timer: Timer | None = None

    @property
    def due_ns(self) -> int:
        """When a turn is due behind a frame."""
        return self._looked_ns + self._served_ns

    def start(self) -> None:
        """Begin, also anew when nobody sends frames any more: with a turn at once, and then each millisecond."""
        self._serves, self._looked_ns = False, self._loop.now_ns()
        self._turn()
        self._wait()

    def behind_a_frame(self) -> None:
        """A frame has been served: the next one is not there yet."""
        self._serves, now_ns = True, self._loop.now_ns()
        if now_ns >= self.due_ns:
            self._looked_ns = now_ns
            self._turn()
            self._wait()

    def serves_no_more(self) -> None:
        """Compiled code serves no frames, or none come: have a turn now, where that is new, and each millisecond."""
        if self._serves:
            self.start()

    def _wait(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_at(self._gone_ns, self._is_gone)

    @property
    def _gone_ns(self) -> int:
        return self.due_ns + _GONE_NS if self._serves else self._looked_ns + _IDLE_NS

    def _is_gone(self) -> None:
        if self._loop.now_ns() >= self._gone_ns:
            self.start()
        else:
            self._wait()
