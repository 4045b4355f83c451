"""Bits of a frame to values and back, as tables say: what ``plan.py`` does in Python, bit for bit the same."""

from __future__ import annotations

from typing import Any

import numpy as np

from micromanip.driver.datagrams import find_code, value_of_code

from .records import compiled

_U0, _BYTE = np.uint64(0), np.uint64(255)


@compiled
def place(n: Any, first: int, length: int, j: int) -> int:
    """Where in the packet the byte `j` of a signal is, counted from its lowest; the data begins at `first`."""
    return first + length - 1 - n["byte"] - j if n["big"] != 0 else first + n["byte"] + j


@compiled
def low_bytes(data: Any, first: int, length: int) -> Any:
    """The `length` bytes of `data` from `first` on, 8 at most, as one number (uint64), the first byte the lowest."""
    number = _U0
    for j in range(length):
        number |= np.uint64(data[first + j]) << np.uint64(8 * j)
    return number


@compiled
def code_bits(n: Any, data: Any, first: int, length: int) -> Any:
    """The bits of a signal (uint64) in the `length` bytes of `data` from `first` on."""
    shift, bits = n["bit"], n["bits"]
    count = (shift + bits + 7) >> 3
    code = _U0
    for j in range(min(count, 8)):
        code |= np.uint64(data[place(n, first, length, j)]) << np.uint64(8 * j)
    code >>= np.uint64(shift)
    if count > 8:  # only with a shift of 1 at least
        code |= np.uint64(data[place(n, first, length, 8)]) << np.uint64(64 - shift)
    return code if bits == 64 else code & ((np.uint64(1) << np.uint64(bits)) - np.uint64(1))


@compiled
def put_code_bits(n: Any, data: Any, first: int, length: int, code: Any) -> None:
    """Add the bits of a signal to data that is 0 there."""
    shift, bits = n["bit"], n["bits"]
    count = (shift + bits + 7) >> 3
    low = code << np.uint64(shift)
    for j in range(min(count, 8)):
        data[place(n, first, length, j)] |= np.uint8((low >> np.uint64(8 * j)) & _BYTE)
    if count > 8:
        data[place(n, first, length, 8)] |= np.uint8((code >> np.uint64(64 - shift)) & _BYTE)


@compiled
def value_of(n: Any, data: Any, first: int, length: int, scratch: Any) -> float:
    """The value of a signal; `scratch` is uint64 (1,)."""
    return value_of_code(n, code_bits(n, data, first, length), n["bits"], scratch)


@compiled
def put_value(n: Any, data: Any, first: int, length: int, value: float, scratch: Any) -> bool:
    """Add `value`, rounded to the nearest code, to data that is 0 there; False, with nothing done, where it can't be
    sent.
    """
    if not find_code(n, value, n["bits"], scratch):
        return False
    put_code_bits(n, data, first, length, scratch[0])
    return True
