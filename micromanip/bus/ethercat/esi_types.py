"""Types of an ESI file by ours."""

from __future__ import annotations

from collections.abc import Mapping

from micromanip.bus.number_options import BITS, PACKED

_OURS = {
    "SINT": "int8", "USINT": "uint8", "BYTE": "uint8", "BITARR8": "uint8", "BIT8": "uint8",
    "INT": "int16", "UINT": "uint16", "WORD": "uint16", "BITARR16": "uint16", "BIT16": "uint16",
    "DINT": "int32", "UDINT": "uint32", "DWORD": "uint32", "BITARR32": "uint32", "REAL": "float32",
    "LINT": "int64", "ULINT": "uint64", "LWORD": "uint64", "LREAL": "float64",
    "BOOL": "bool", "BIT": "bool", "BIT1": "bool",
    **{kind.upper(): kind for kind in BITS},
}  # fmt: skip
"""By ETG.1020, and UINT16 and the like, as some makers write them; there are others, of texts."""
_UNSIGNED = {bits: kind for kind, bits in BITS.items() if kind.startswith(("u", "b"))}
_MOST_CHAINED = 8


def field_type(kind: str, bits: int) -> str | None:
    """Our type of an entry with a type of the file and so many bits; None where there is none that means the same.

    Fewer bits than those of an unsigned number are the lower ones of it.
    """
    ours = _OURS.get(kind)
    if ours is None or BITS[ours] == bits:
        return ours
    return unsigned_type(bits) if ours.startswith("u") and unsigned_type(bits) in PACKED else None


def unsigned_type(bits: int) -> str | None:
    """Our type of so many bits that mean nothing, or nothing that we know of."""
    return _UNSIGNED.get(bits)


def known_type(said: str, own_types: Mapping[str, str]) -> str:
    """A type as `field_type` knows it, of a file's own that which it is based on; else as it is `said`."""
    name = said
    for _ in range(_MOST_CHAINED):
        if name.upper() in _OURS:
            return name.upper()
        name = own_types.get(name, "")
    return said
