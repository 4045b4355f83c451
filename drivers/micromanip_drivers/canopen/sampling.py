"""When the values of a PDO were taken, and whether any are missing."""

from __future__ import annotations

from collections import deque

_REMEMBERED = 16


class SyncTimes:
    """When our last SYNCs went out."""

    def __init__(self) -> None:
        self._count = 0
        self._sent: deque[tuple[int, int]] = deque(maxlen=_REMEMBERED)

    def clear(self) -> None:
        """Forget them: the bus was opened anew."""
        self._sent.clear()

    def add(self, time_ns: int) -> None:
        """One was on the bus at `time_ns`."""
        self._count += 1
        self._sent.append((self._count, time_ns))

    def first(self, after: int, from_ns: int, to_ns: int) -> tuple[int, int] | None:
        """Number and time of the first with a number above `after` that was sent in that time; None without one."""
        for count, sent_ns in self._sent:
            if count > after and from_ns <= sent_ns <= to_ns:
                return count, sent_ns
        return None


class EventSampling:
    """Of a PDO that the node sends by its own clock: taken just before it was sent."""

    def __init__(self, age_ns: int) -> None:
        self._age_ns = age_ns

    def clear(self) -> None:
        """Nothing is remembered."""

    def taken(self, received_ns: int, data: bytes) -> tuple[int, int]:  # noqa: ARG002
        """When the values were taken, and how many samples before them are missing."""
        return received_ns - self._age_ns, 0


class SyncSampling:
    """Of a synchronous PDO: taken at the SYNC that it answers, however long it then waited for the bus.

    SYNCs are answered in their order, which matters when one was sent late and the next one is close behind. One that
    no PDO answered within its time is a lost sample. The same PDO twice for one SYNC is a repetition, and no fresh
    sample; another one for the same SYNC is not the answer to it, and dated by its reception.
    """

    def __init__(self, syncs: SyncTimes, every: int, frame_ns: int, latency_ns: int, lasting_ns: int) -> None:
        """`every` n-th SYNC is answered within `lasting_ns` by a frame of `frame_ns`; values are `latency_ns` old."""
        self._syncs, self._every = syncs, every
        self._frame_ns, self._latency_ns, self._lasting_ns = frame_ns, latency_ns, lasting_ns
        self._answered: int | None = None
        self._last = b""

    def clear(self) -> None:
        """The bus was opened anew."""
        self._answered = None

    def taken(self, received_ns: int, data: bytes) -> tuple[int, int] | None:
        """When the values were taken, and how many samples before them are missing; None for a repetition."""
        began_ns = received_ns - self._frame_ns
        repeated, self._last = data == self._last, data
        answered = 0 if self._answered is None else self._answered
        sync = self._syncs.first(answered, began_ns - self._lasting_ns, began_ns)
        if sync is None:
            recent = self._syncs.first(answered - 1, began_ns - self._lasting_ns, began_ns) is not None
            return None if repeated and recent else (began_ns - self._latency_ns, 0)
        count, sent_ns = sync
        lost = 0 if self._answered is None else max(0, round((count - self._answered) / self._every) - 1)
        self._answered = count
        return sent_ns - self._latency_ns, lost
