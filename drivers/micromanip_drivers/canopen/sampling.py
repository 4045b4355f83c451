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

    def before(self, time_ns: int) -> tuple[int, int] | None:
        """Number and time of the last one before `time_ns`; None if there was none lately."""
        for count, sent_ns in reversed(self._sent):
            if sent_ns <= time_ns:
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

    A SYNC that no PDO answered is a lost sample. The same PDO twice for one SYNC is a repetition, and no fresh sample;
    another one for the same SYNC is not the answer to it, and dated by its reception.
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
        sync = self._syncs.before(began_ns)
        last, self._last = self._last, data
        if sync is None or began_ns - sync[1] > self._lasting_ns:
            return began_ns - self._latency_ns, 0
        count, sent_ns = sync
        if count == self._answered:
            return None if data == last else (began_ns - self._latency_ns, 0)
        lost = 0 if self._answered is None else max(0, round((count - self._answered) / self._every) - 1)
        self._answered = count
        return sent_ns - self._latency_ns, lost
