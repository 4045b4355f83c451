"""Where the parts of a frame lie: none shares a byte with another, all are inside."""

from __future__ import annotations

from collections.abc import Iterable

from micromanip.driver import ConfigError

from .field_options import Number, overlap

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
