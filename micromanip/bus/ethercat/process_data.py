"""Where the entries of PDOs lie in the process data of a terminal: one behind the other, by bits (ETG.1000.6)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class PackedNumber:
    """A number of the process data, as ``FramePlan`` takes it; EtherCAT's byte order is little.

    One that is whole bytes has a `size`; of any other that is 0, and it is `bits` from number `bit` of byte `at` on.
    """

    at: int
    size: int
    bit: int
    bits: int
    type: str
    scale: float = 1.0
    offset: float = 0.0
    range: tuple[float, float] | None = None
    byte_order: str = "little"


def packed_numbers(pdos: Mapping[str, Any], at: int) -> Iterator[tuple[Any, dict[str, PackedNumber]]]:
    """Each PDO of a direction with its numbers by field, from byte `at` on."""
    place = 8 * at
    for pdo in pdos.values():
        numbers = {}
        for name, field in pdo.fields.items():
            is_whole = place % 8 == 0 and field.bits % 8 == 0
            size = field.bits // 8 if is_whole else 0
            limits = field.scale, field.offset, getattr(field, "range", None)
            numbers[name] = PackedNumber(place // 8, size, place % 8, field.bits, field.type, *limits)
            place += field.bits
        yield pdo, numbers


def bytes_of(entry_bits: Iterator[int]) -> int:
    """How many bytes entries of so many bits take together."""
    return (sum(entry_bits) + 7) // 8


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
