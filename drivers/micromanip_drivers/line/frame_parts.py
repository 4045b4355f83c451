"""Parts of a frame: where they lie, numbers as values and back, its counter, its sender's word whether all is well."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from micromanip.driver import ConfigError
from micromanip.driver.wire import DeviceCounter, NumberCodec

from ..sent_number import sent_number
from .frame_options import BAD, InputField, Number, OutputField, Status, overlap

Part = tuple[str, int, int]
"""Key in the configuration, first byte, byte behind the last."""


def part(key: str, number: Number | None) -> list[Part]:
    """Of a number that may be left out."""
    return [] if number is None else [(key, number.at, number.end)]


def laid_out(key: str, parts: Iterable[Part], given: int | None, crc_size: int) -> int:
    """Length of a frame, checksum included: `given`, or up to the end of its last part. Raises ConfigError."""
    known = list(parts)
    end = max((end for _, _, end in known), default=0)
    length = end + crc_size if given is None else given
    if crc_size:
        known.append(("its CRC", length - crc_size, length))
    if problem := overlap(known):
        raise ConfigError(f"{key}: {problem}")
    if end > length:
        last = max(known, key=lambda one: one[2])
        raise ConfigError(f"{key}: {last[0]} ends behind byte {length - 1}, the last of {length}")
    return length


class StatusWord:
    """A number of a frame as the status of its samples: 0 is good."""

    def __init__(self, options: Status) -> None:
        self._codec = NumberCodec(options)
        self._mask = (1 << (8 * options.size)) - 1 if options.mask is None else options.mask
        self._good = frozenset(options.good)

    def of(self, frame: bytes) -> int:
        """0, or the device's word for what is wrong."""
        word = int(self._codec.read(frame)) & self._mask
        return 0 if word in self._good else word or BAD


class InputNumber:
    """A number of a frame as a value: scale x number + offset."""

    def __init__(self, options: InputField) -> None:
        self._codec = NumberCodec(options)
        self._scale, self._offset = options.scale, options.offset

    def value(self, data: bytes | bytearray, at: int = 0) -> float:
        """The value; not finite where a floating-point number is not."""
        return self._codec.read(data, at) * self._scale + self._offset


class OutputNumber:
    """A value as a number of a frame, with the range that it may have."""

    def __init__(self, name: str, options: OutputField) -> None:
        self._codec = codec = NumberCodec(options)
        low, high = sorted(end * options.scale + options.offset for end in (codec.low, codec.high))
        limits = options.range or (low, high)
        self._law = name, options.scale, options.offset, (codec.low, codec.high), limits, not codec.floating

    def put(self, data: bytearray, value: float) -> None:
        """Write `value`, rounded to the nearest number. Raises OutputRefused."""
        self._codec.write(data, sent_number(value, *self._law))


def mismatches(numbers: Mapping[str, tuple[NumberCodec, int]], data: bytes) -> Sequence[str]:
    """Which of the `numbers`, given with what they must be, are other ones in `data`: in words."""
    found = ((name, codec.read(data), wanted) for name, (codec, wanted) in numbers.items())
    return [f"{name} {number}, the configuration says {wanted}" for name, number, wanted in found if number != wanted]


class PacketCounter(DeviceCounter):
    """`by_sample`: the number is that of the packet's first sample, else that of the packet."""

    def __init__(self, options: Number, by_sample: bool = False) -> None:
        super().__init__(1 << 8 * options.size)
        self._codec, self.by_sample = NumberCodec(options), by_sample
        self._more = 0

    def samples_before(self, packet: bytes, samples: int = 1) -> int | None:
        """Samples known to be missing before the `samples` of a packet; None for a packet that is not fresh."""
        missing = self.lost_before(int(self._codec.read(packet)), samples if self.by_sample else 1)
        if missing is None or self.by_sample:
            return missing
        self._more += missing * (samples - 1)
        return missing * samples

    @property
    def lost(self) -> int:
        """Samples that are known to be missing, up to now."""
        return self.counted("lost") + self._more

    @property
    def stale(self) -> int:
        """Packets that were not fresh."""
        return self.counted("doubled") + self.counted("late")

    @property
    def restarts(self) -> int:
        """How often the device began anew."""
        return self.counted("restarts")


class Incoming:
    """A kind of frame that is received: its number where there are several kinds, its bytes, its first input.

    It has so many `samples` of each input, and is counted by `counter`, alone or with others.
    """

    kind: int | None
    length: int
    first: int
    samples: int
    counter: PacketCounter | None

    def table(self) -> NDArray[np.void]:
        """An array of one FRAME, for compiled code. Raises ConfigError."""
        raise NotImplementedError
