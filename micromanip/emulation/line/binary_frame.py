"""Binary frames from the device's side: sync bytes, length, kind, counter, checksum, as the configuration has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from .number import LineNumber


@dataclass(frozen=True)
class FrameLayout:
    """One kind of frame."""

    name: str
    kind: int | None
    size: int
    """All of its bytes, with the checksum."""
    counter: LineNumber | None
    status: LineNumber | None
    good_status: int
    fields: dict[str, LineNumber]


@dataclass(frozen=True)
class FrameFormat:
    """What all frames of a line have in common."""

    sync: bytes
    length: LineNumber | None
    length_plus: int
    kind: LineNumber | None
    checksum: Any
    """The driver's keys of it; None without one."""

    def built(self, layout: FrameLayout, values: Mapping[str, float], count: int = 0) -> bytes:
        """A whole frame; bytes that nothing covers are 0."""
        end = layout.size - (self.checksum.size if self.checksum else 0)
        frame = bytearray(end)
        frame[: len(self.sync)] = self.sync
        if self.length is not None:
            self.length.write(frame, layout.size - self.length_plus)
        if self.kind is not None and layout.kind is not None:
            self.kind.write(frame, layout.kind)
        if layout.counter is not None:
            layout.counter.write(frame, count % layout.counter.counts)
        if layout.status is not None:
            layout.status.write(frame, layout.good_status)
        for name, number in layout.fields.items():
            number.put(frame, values[name])
        return bytes(frame) + (self.checksum.of(bytes(frame)) if self.checksum else b"")

    def size_at_end_of(self, parts: list[LineNumber]) -> int:
        """Bytes of a frame that ends with the last of its parts and the checksum."""
        header = [part.end for part in (self.length, self.kind) if part is not None]
        end = max([len(self.sync), *header, *(part.end for part in parts)])
        return end + (self.checksum.size if self.checksum else 0)


class FrameReader:
    """Finds the frames in a stream of bytes; what fits nowhere is skipped byte by byte."""

    def __init__(self, frame_format: FrameFormat, size_of_kind: Callable[[int | None], int | None]) -> None:
        """`size_of_kind` tells the bytes of a frame by its kind; None for a kind that doesn't exist."""
        self.bad = 0
        """Frames whose checksum was wrong."""
        self._format, self._size_of_kind = frame_format, size_of_kind
        self._bytes = bytearray()
        length, kind = frame_format.length, frame_format.kind
        self._header = max([len(frame_format.sync), *(part.end for part in (length, kind) if part is not None)])

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that are complete with `data`."""
        self._bytes += data
        frames = []
        while (frame := self._next()) is not None:
            frames.append(frame)
        return frames

    def _next(self) -> bytes | None:
        sync = self._format.sync
        while True:
            start = self._bytes.find(sync)
            if start < 0:
                del self._bytes[: max(0, len(self._bytes) - len(sync) + 1)]
                return None
            del self._bytes[:start]
            if len(self._bytes) < self._header:
                return None
            size = self._size()
            if size is None or size < self._header:
                del self._bytes[:1]
                continue
            if len(self._bytes) < size:
                return None
            frame = bytes(self._bytes[:size])
            if self._format.checksum is None or self._format.checksum.fits(frame):
                del self._bytes[:size]
                return frame
            self.bad += 1
            del self._bytes[:1]

    def _size(self) -> int | None:
        """As the frame says it, where it does; a size that its kind can't have is none."""
        header, kind = bytes(self._bytes[: self._header]), self._format.kind
        known = self._size_of_kind(kind.code(header) if kind is not None else None)
        if self._format.length is None:
            return known
        said = self._format.length.code(header) + self._format.length_plus
        return said if said == known else None
