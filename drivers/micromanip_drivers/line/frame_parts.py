"""Parts of a frame beside its values: where they lie, the counter of its sender, its word on whether all is well."""

from __future__ import annotations

from collections.abc import Iterable

from micromanip.driver import ConfigError

from .frame_options import Number, Status, overlap
from .number import NumberCodec

Part = tuple[str, int, int]
"""Key in the configuration, first byte, byte behind the last."""
_RESTARTED_AFTER = 3
"""So many packets in a row that go on from a count in the past: the device began anew, it is no reordering."""
_BAD = -1
"""Status of samples whose device says 0, and 0 is not good."""


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


class PacketCounter:
    """Counts what is missing; `by_sample`: the number is that of the packet's first sample, else that of the packet.

    A number that was there already is no news: the device repeats itself, or is frozen. One from the past, by less than
    half of the counter's range, was overtaken on its way. Neither is fresh.
    """

    def __init__(self, options: Number, by_sample: bool = False) -> None:
        self._codec = NumberCodec(options)
        self._by_sample = by_sample
        self._counts = self._codec.counts
        self._next: int | None = None
        self._next_of_past: int | None = None
        self._in_order = 0
        self.lost = self.stale = self.restarts = 0

    def forget(self) -> None:
        """Begin anew: what comes next is taken as it is."""
        self._next = self._next_of_past = None

    def lost_before(self, packet: bytes, samples: int = 1) -> int | None:
        """Samples known to be missing before the `samples` of a packet; None for a packet that is not fresh."""
        count = int(self._codec.read(packet))
        after = (count + (samples if self._by_sample else 1)) % self._counts
        missing = 0 if self._next is None else (count - self._next) % self._counts
        if missing >= self._counts // 2:
            if not self._began_anew(count, after):
                self.stale += 1
                return None
            self.restarts += 1
            missing = 0
        self._next, self._next_of_past, self._in_order = after, None, 0
        lost = missing if self._by_sample else missing * samples
        self.lost += lost
        return lost

    def _began_anew(self, count: int, after: int) -> bool:
        self._in_order = self._in_order + 1 if count == self._next_of_past else 1
        self._next_of_past = after
        return self._in_order > _RESTARTED_AFTER


class StatusWord:
    """A number of a frame as the status of its samples: 0 is good."""

    def __init__(self, options: Status) -> None:
        self._codec = NumberCodec(options)
        self._mask = (1 << (8 * options.size)) - 1 if options.mask is None else options.mask
        self._good = frozenset(options.good)

    def of(self, frame: bytes) -> int:
        """0, or the device's word for what is wrong."""
        word = int(self._codec.read(frame)) & self._mask
        return 0 if word in self._good else word or _BAD
