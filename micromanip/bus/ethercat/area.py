"""Which PDOs of a direction lie in one area of a terminal's memory: the master exchanges one area each way.

A sync manager is an area. What another one has belongs to it where that begins at the byte at which the one before
ends, as with 16 digital lines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator


def in_first_area(pdos: Iterable[tuple[int, int]], begins_after: Callable[[int, int, int], bool]) -> Iterator[bool]:
    """Of PDOs in their order, (sync manager, bits) each, whether they lie in the area of the first.

    ``begins_after(manager, before, bits)`` says whether a sync manager begins where another ends that has so many bits.
    """
    current, bits = None, 0
    for manager, its_bits in pdos:
        if current is not None and manager != current:
            if not begins_after(manager, current, bits):
                yield False
                continue
            bits = 0
        current = manager
        bits += its_bits
        yield True
