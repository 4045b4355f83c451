"""Parts of a frame beside its values: where they lie, its sender's word on whether all is well."""

from __future__ import annotations

from collections.abc import Iterable

from micromanip.driver import ConfigError
from micromanip.driver.wire import NumberCodec

from .frame_options import Number, Status, overlap

Part = tuple[str, int, int]
"""Key in the configuration, first byte, byte behind the last."""
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
