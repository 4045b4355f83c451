"""A slot of the file of what a device was given last: what compiled and Python workers write alike.

Its number, the values, and a checksum, each a word of 8 bytes.
"""

from __future__ import annotations

from typing import Any

_PRIME, _FACTOR = 2147483647, 16777619
"""Every step fits into 64 bits with a sign, in compiled code as in Python."""


def size(values: int) -> int:
    """Words of a slot with so many values."""
    return values + 2


def sealed(words: Any, seed: int) -> int:
    """The checksum of a slot, all its `words` but the last, which begins with `seed`."""
    check = int(seed) % _PRIME
    for i in range(len(words) - 1):
        word = int(words[i])
        check = (check * _FACTOR + (word & 0xFFFFFFFF)) % _PRIME
        check = (check * _FACTOR + (word >> 32 & 0xFFFFFFFF)) % _PRIME
    return check
