"""Numbers in frames of a device that speaks by itself (what does not fit is the nearest that does), and its frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from micromanip.bus.number_options import NumberCodec


class LineNumber(NumberCodec):
    """value = scale x number + offset."""

    def __init__(self, keys: Any, scale: float | None = None) -> None:
        """`keys` are the driver's; `scale` is for those that have none."""
        super().__init__(keys)
        self.end: int = keys.end
        """The byte behind its last."""
        self._scale: float = getattr(keys, "scale", 1.0) if scale is None else scale
        self._offset: float = getattr(keys, "offset", 0.0)

    def put(self, frame: bytearray, value: float) -> None:
        """Write a value: the nearest that it can hold; NaN as such where the type has it, else as the largest code."""
        number = (value - self._offset) / self._scale
        if not self.floating:
            number = self.high if math.isnan(number) else round(min(max(number, self.low), self.high))
        self.write(frame, number)

    def get(self, frame: bytes) -> float:
        """Its value."""
        return self._scale * self.read(frame) + self._offset

    def code(self, frame: bytes) -> int:
        """It as a whole number, without scale."""
        return int(self.read(frame))


def optional_number(keys: Any) -> LineNumber | None:
    """The number that these keys of the driver describe, where the device may have none."""
    return None if keys is None else LineNumber(keys)


def line_numbers(keys: Mapping[str, Any]) -> dict[str, LineNumber]:
    """Several, by name."""
    return {name: LineNumber(number) for name, number in keys.items()}


class FrameFormat:
    """What all frames of a line have in common, by the driver's keys `binary`."""

    def __init__(self, keys: Any) -> None:
        self.sync, self.checksum = bytes.fromhex(keys.sync), keys.crc
        self.length, self.kind = optional_number(keys.length), optional_number(keys.kind)
        self.plus = keys.length.plus if keys.length else 0
        self.header = max([len(self.sync), *(part.end for part in (self.length, self.kind) if part is not None)])
        """Bytes that say of which kind a frame is, and how long."""

    def sealed(self, frame: bytes) -> bytes:
        """With its checksum."""
        return frame + (self.checksum.of(frame) if self.checksum else b"")


class FrameLayout:
    """One kind of frame."""

    def __init__(self, form: FrameFormat, name: str, keys: Any, fields: Mapping[str, Any]) -> None:
        """`keys` are the driver's of the message, `fields` its numbers."""
        self.name, self.kind, self.fields = name, keys.kind, line_numbers(fields)
        status = getattr(keys, "status", None)
        self._form, self._good = form, status.good[0] if status else 0
        self._counter, self._status = optional_number(getattr(keys, "counter", None)), optional_number(status)
        ends = [part.end for part in (*self.fields.values(), self._counter, self._status) if part is not None]
        self.size: int = keys.bytes or max([form.header, *ends]) + (form.checksum.size if form.checksum else 0)
        """All of its bytes, with the checksum."""

    def built(self, values: Mapping[str, float], count: int = 0) -> bytes:
        """A whole frame; bytes that nothing covers are 0."""
        form = self._form
        frame = bytearray(self.size - (form.checksum.size if form.checksum else 0))
        frame[: len(form.sync)] = form.sync
        if form.length is not None:
            form.length.write(frame, self.size - form.plus)
        if form.kind is not None and self.kind is not None:
            form.kind.write(frame, self.kind)
        if self._counter is not None:
            self._counter.write(frame, count % self._counter.counts)
        if self._status is not None:
            self._status.write(frame, self._good)
        for name, number in self.fields.items():
            number.put(frame, values[name])
        return form.sealed(bytes(frame))


class FrameReader:
    """Finds the frames in a stream of bytes; what fits nowhere is skipped byte by byte."""

    def __init__(self, form: FrameFormat, size_of_kind: Callable[[int | None], int | None]) -> None:
        """`size_of_kind` tells the bytes of a frame by its kind; None for a kind that doesn't exist."""
        self.bad = 0
        """Frames whose checksum was wrong."""
        self._form, self._size_of_kind = form, size_of_kind
        self._bytes = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that are complete with `data`."""
        self._bytes += data
        frames = []
        while (frame := self._next()) is not None:
            frames.append(frame)
        return frames

    def _next(self) -> bytes | None:
        form, sync = self._form, self._form.sync
        while True:
            start = self._bytes.find(sync)
            if start < 0:
                del self._bytes[: max(0, len(self._bytes) - len(sync) + 1)]
                return None
            del self._bytes[:start]
            if len(self._bytes) < form.header:
                return None
            size = self._size()
            if size is not None and form.header <= size:
                if len(self._bytes) < size:
                    return None
                frame = bytes(self._bytes[:size])
                if form.checksum is None or form.checksum.fits(frame):
                    del self._bytes[:size]
                    return frame
                self.bad += 1
            del self._bytes[:1]

    def _size(self) -> int | None:
        """As the frame says it, where it does; a size that its kind can't have is none."""
        form, header = self._form, bytes(self._bytes[: self._form.header])
        known = self._size_of_kind(form.kind.code(header) if form.kind is not None else None)
        if form.length is None:
            return known
        said = form.length.code(header) + form.plus
        return said if said == known else None
