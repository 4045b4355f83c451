"""Frames out of a stream of bytes: found by their sync bytes, believed by length, checksum and layout.

However the bytes are cut into chunks, the same frames come of them. After garbage, a frame that is cut short or one
with a wrong bit, the search goes on at the byte behind the one where it had begun: the next good frame is found, even
one that lies inside of what looked like a frame.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import cycle

from micromanip.driver import Answer, IdentityMismatch, LinkError, StillOpening, TransientError

from .frame_options import Crc
from .port import Port

STALE_NS = 50_000_000
"""A frame that stands still for so long in its middle will not go on."""

_ASK_NS, _AGAIN_NS = 150_000_000, 50_000_000
"""So long the device has to say who it is, before it is asked again; and what a probe asks."""
_STRANGE = 2
"""So many frames must say that it is another device: one may be noise that looked like a frame."""

Chunk = tuple[bytes, int]
"""Bytes that came together, and when."""
Measure = Callable[[bytes | bytearray], int | None]
"""From the bytes behind which a frame begins, to its length: 0 for one that can't be, None where more is needed."""


class FrameSearch:
    """Finds frames that begin with `sync`.

    `measure` gets what is there from a frame's first byte on, and says how long the frame is. Without a checksum a
    frame counts only if another one, or nothing yet, follows directly, and none begins inside of it.
    """

    def __init__(self, sync: bytes, measure: Measure, crc: Crc | None) -> None:
        self._sync, self._measure = sync, measure
        self._checksum = crc.function if crc else None
        self._crc_size = crc.size if crc else 0
        self._crc_order = crc.byte_order if crc else "little"
        self._covered = crc.first if crc else 0
        self._buffer = bytearray()
        self._fed, self._marks = 0, deque[tuple[int, int]]()  # bytes up to now; (bytes, when) of each chunk
        self.bad = 0
        """Frames whose checksum, length or surroundings were wrong."""
        self.skipped = 0
        """Bytes that belonged to no frame."""

    def clear(self) -> None:
        """Forget what is there of a frame."""
        self._buffer.clear()
        self._marks.clear()

    @property
    def begun(self) -> list[Chunk]:
        """What is there of a frame, in the chunks in which it came."""
        at, chunks = self._fed - len(self._buffer), []
        for end, time_ns in self._marks:
            if end > at:
                chunks.append((bytes(self._buffer[at - self._fed : end - self._fed or None]), time_ns))
                at = end
        return chunks

    def feed(self, data: bytes, now_ns: int) -> list[tuple[bytes, int]]:
        """The frames that are complete with `data`, which came at `now_ns`; each with the time of its last byte."""
        self._buffer += data
        self._fed += len(data)
        self._marks.append((self._fed, now_ns))
        return self._found()

    def quiet(self, now_ns: int) -> list[tuple[bytes, int]]:
        """Nothing had come by `now_ns`: frames that lie inside of one that stands still for too long."""
        if not self._buffer or now_ns - self._marks[-1][1] <= STALE_NS:
            return []
        self.bad += 1
        self._reject()
        return self._found()

    def whole(self, datagram: bytes, now_ns: int) -> list[tuple[bytes, int]]:
        """The frames of a datagram, in which they are whole; what is left of it is garbage."""
        self.clear()
        frames = self.feed(datagram, now_ns)
        while self._buffer:
            self.bad += 1
            self._reject()
            frames += self._found()
        return frames

    def _found(self) -> list[tuple[bytes, int]]:
        frames: list[tuple[bytes, int]] = []
        while (frame := self._next()) is not None:
            if frame:
                frames.append((frame, self._came_ns()))
        return frames

    def _came_ns(self) -> int:
        """When the last byte came that was taken out of the buffer."""
        taken, marks = self._fed - len(self._buffer), self._marks
        while len(marks) > 1 and marks[0][0] < taken:
            marks.popleft()
        return marks[0][1]

    def _next(self) -> bytes | None:
        """The next frame, an empty one where the search has to go on, None where more bytes are needed."""
        buffer, sync = self._buffer, self._sync
        start = buffer.find(sync)
        if start < 0:
            start = max(0, len(buffer) - len(sync) + 1)
            while start < len(buffer) and not sync.startswith(buffer[start:]):
                start += 1
        if start:
            self.skipped += start
            del buffer[:start]
        if len(buffer) < len(sync):
            return None
        length = self._measure(buffer)
        if length is None or len(buffer) < (length or 0):
            return None
        frame = bytes(buffer[:length])
        if not length or not self._is_good(frame, buffer):
            self.bad += 1
            self._reject()
            return b""
        del buffer[:length]
        return frame

    def _is_good(self, frame: bytes, buffer: bytearray) -> bool:
        if self._checksum is not None:
            return self._adds_up(frame) and not self._is_crossed(len(frame), buffer)
        after = bytes(buffer[len(frame) : len(frame) + len(self._sync)])
        return self._sync.startswith(after) and self._sync not in frame[1:]

    def _adds_up(self, frame: bytes) -> bool:
        assert self._checksum is not None
        end = len(frame) - self._crc_size
        return self._checksum(frame[self._covered : end]) == int.from_bytes(frame[end:], self._crc_order)

    def _is_crossed(self, length: int, buffer: bytearray) -> bool:
        """Whether a good frame begins inside of these `length` bytes, and ends behind them.

        Then that one is real, and what looks like a frame is one that was cut short and the beginning of the next: a
        checksum of 8 bits agrees by chance with one of 256 of them.
        """
        last = length + len(self._sync) - 1
        at = buffer.find(self._sync, 1, last)
        while at > 0:
            inner = self._measure(buffer[at:])
            if inner and length < at + inner <= len(buffer) and self._adds_up(bytes(buffer[at : at + inner])):
                return True
            at = buffer.find(self._sync, at + 1, last)
        return False

    def _reject(self) -> None:
        del self._buffer[:1]
        self.skipped += 1


class FrameReader:
    """The frames that `search` finds in what `port` receives."""

    def __init__(self, port: Port, search: FrameSearch) -> None:
        self._port, self._search = port, search
        self._told = 0
        self._left: list[Chunk] = []

    def forget(self) -> None:
        """What was begun will not go on."""
        self._search.clear()
        self._left = []
        self._told = self._search.bad

    def leave(self, chunks: list[Chunk]) -> None:
        """These came already, and are to be looked at first."""
        self._left += chunks

    def begun(self, most_bytes: int, most_chunks: int) -> list[Chunk] | None:
        """Hand over what is there of a frame, forgetting it; None where it is more than that, or was not looked at."""
        chunks = self._search.begun
        if self._left or sum(len(data) for data, _ in chunks) > most_bytes or len(chunks) > most_chunks:
            return None
        self._search.clear()
        return chunks

    def pardon(self) -> None:
        """Say nothing of what was damaged up to now."""
        self._told = self._search.bad

    def frames(self, until_ns: int) -> list[tuple[bytes, int]]:
        """What came, each with the time of its last byte; soon after the first, and at `until_ns` at the latest.

        Also returns, without any, once something damaged came (see `complain`). Raises LinkError.
        """
        search = self._search
        frames, self._left = self._frames_in(self._left), []
        while not frames:
            chunks = self._port.receive(until_ns)
            frames = self._frames_in(chunks) if chunks else search.quiet(time.monotonic_ns())
            if search.bad != self._told or time.monotonic_ns() >= until_ns:
                break
        return frames

    def first(
        self, deadline_ns: int, against: Callable[[bytes], Sequence[str] | None], otherwise: str, asking: bytes = b""
    ) -> int:
        """When the first frame came of the device that is meant; `asking` is sent now and then until it does.

        `against` says what speaks against a frame, in words; None for one that says nothing about that. Raises
        IdentityMismatch for another device, LinkError, for which `otherwise` is what it does not do; StillOpening where
        it may just be starting.
        """
        before, strange = self.received, 0
        while (now_ns := time.monotonic_ns()) < deadline_ns:
            if asking:
                self._port.send(asking)
            until_ns, asks_again = min(deadline_ns, now_ns + _ASK_NS), False
            while time.monotonic_ns() < until_ns and not asks_again:
                for frame, time_ns in self.frames(until_ns):
                    found = against(frame)
                    if found is not None and not found:
                        self.pardon()
                        return time_ns
                    if found:
                        strange, asks_again = strange + 1, True
                        if strange >= _STRANGE:
                            raise IdentityMismatch(f"{self._port.name} has {' and '.join(found)}")
                self.pardon()
        lost = StillOpening if self._port.may_be_starting else LinkError
        raise lost(f"{self._port.name} {self.unheard(before, otherwise)}")

    def all_of(self, describe: Callable[[bytes], Answer], asking: Sequence[bytes], seconds: float) -> Iterator[Answer]:
        """For a probe, each frame as it comes, described; `asking` are frames that move nothing, sent in turns."""
        before, begin_ns = self.received, time.monotonic_ns()
        end_ns, turns = begin_ns + round(seconds * 1e9), cycle(asking)
        seen: dict[str, int] = {}
        while (now_ns := time.monotonic_ns()) < end_ns:
            if asking:
                self._port.send(next(turns))
            until_ns = min(end_ns, now_ns + _AGAIN_NS)
            while time.monotonic_ns() < until_ns:
                for frame, time_ns in self.frames(until_ns):
                    answer = describe(frame)
                    seen[answer.name] = seen.get(answer.name, 0) + 1
                    rate_hz = round(seen[answer.name] / max(1e-3, (time_ns - begin_ns) * 1e-9), 1)
                    yield replace(answer, values={"frames_per_s": rate_hz, **answer.values})
                self.pardon()
        if not seen and self.received > before:
            unheard = self.unheard(before, "sends nothing")
            yield Answer(self._port.name, {"bytes": self.received - before}, unheard, is_value=False)

    def _frames_in(self, chunks: list[Chunk]) -> list[tuple[bytes, int]]:
        take = self._search.whole if self._port.datagrams else self._search.feed
        return [frame for data, time_ns in chunks for frame in take(data, time_ns)]

    def complain(self) -> None:
        """Raises TransientError if there was a damaged frame since the last call."""
        count = self._search.bad - self._told
        self._told = self._search.bad
        if count:
            raise TransientError(f"{self._port.name}: {count} damaged frame{'s' if count > 1 else ''}")

    @property
    def received(self) -> int:
        """Bytes that came through the port, up to now."""
        return self._port.counters["bytes_in"]

    def unheard(self, before: int, otherwise: str) -> str:
        """Why nothing was understood, in words; `before` is what `received` was in the beginning."""
        count = self.received - before
        if count:
            return f"sends {count} bytes, and no frame is in them: are baud rate, sync bytes, lengths and CRC right?"
        return f"{otherwise}: is it switched on, are the wires and the baud rate right?"

    @property
    def counters(self) -> Mapping[str, int]:
        """What was not understood."""
        return {"bad_frames": self._search.bad, "skipped_bytes": self._search.skipped}
