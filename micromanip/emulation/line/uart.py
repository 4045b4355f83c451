"""What a UART makes of bytes that were sent at another rate than its own."""

from __future__ import annotations

import math

_DATA_BITS = 8


def as_heard(data: bytes, sent_baud: int, heard_baud: int) -> bytes:
    """`data`, sent at `sent_baud` without gaps, as a receiver at `heard_baud` reads it: 8 data bits, no parity.

    The receiver waits for the edge of a start bit and samples in the middle of its own bits. A byte whose stop bit is
    missing is handed over all the same, as most drivers do with framing errors.
    """
    if sent_baud == heard_baud:
        return data
    levels = _levels(data)
    step = sent_baud / heard_baud  # a bit of the receiver, in bits of the sender
    heard, at = bytearray(), 0.0
    while (start := _falling_edge(levels, at)) is not None:
        bits = [_level(levels, start + (1.5 + i) * step) for i in range(_DATA_BITS)]
        heard.append(sum(bit << i for i, bit in enumerate(bits)))
        at = start + (_DATA_BITS + 1.5) * step
    return bytes(heard)


def _levels(data: bytes) -> list[int]:
    """The line, bit by bit: start bit, data from the lowest bit on, stop bit."""
    levels = [1]
    for byte in data:
        levels += [0, *((byte >> i) & 1 for i in range(_DATA_BITS)), 1]
    return levels


def _level(levels: list[int], at: float) -> int:
    """At a time; idle before and after."""
    return levels[int(at)] if at < len(levels) else 1


def _falling_edge(levels: list[int], at: float) -> int | None:
    """When the line next goes from idle to a start bit, from `at` on."""
    for i in range(max(1, math.ceil(at)), len(levels)):
        if levels[i] == 0 and levels[i - 1] == 1:
            return i
    return None
