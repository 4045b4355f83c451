"""Bits of a frame to values and back, as tables say: what ``plan.py`` does in Python, bit for bit the same."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .compiled import compiled
from .records import FLOATING, SIGNED

_U0, _U8, _BYTE = np.uint64(0), np.uint64(8), np.uint64(255)
_HALF_BITS, _HALF_LEAST_EXPONENT, _HALF_GREATEST_EXPONENT = 10, -14, 31


@compiled
def place(n: Any, first: int, length: int, j: int) -> int:
    """Where in the packet the byte `j` of a signal is, counted from its lowest; the data begins at `first`."""
    return first + length - 1 - n["byte"] - j if n["big"] != 0 else first + n["byte"] + j


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
    bits = code_bits(n, data, first, length)
    if n["kind"] == FLOATING:
        if n["bits"] == 16:
            code = half_to_double(int(bits))
        elif n["bits"] == 32:
            scratch.view(np.uint32)[0] = np.uint32(bits)
            code = float(scratch.view(np.float32)[0])
        else:
            scratch[0] = bits
            code = float(scratch.view(np.float64)[0])
    elif n["kind"] == SIGNED:
        unused = 64 - n["bits"]
        scratch[0] = bits << np.uint64(unused)
        code = float(scratch.view(np.int64)[0] >> unused)
    else:
        code = float(bits)
    return code * n["scale"] + n["offset"]


@compiled
def put_value(n: Any, data: Any, first: int, length: int, value: float, scratch: Any) -> bool:
    """Add `value`, rounded to the nearest code, to data that is 0 there; False, with nothing done, where it can't be
    sent.
    """
    if not math.isfinite(value):
        return False
    code = (value - n["offset"]) / n["scale"]
    if n["kind"] != FLOATING:
        code = np.rint(code)
    if not n["lowest"] <= code <= n["highest"]:
        return False
    if n["kind"] == FLOATING:
        if n["bits"] == 16:
            bits = np.uint64(double_to_half(code))
        elif n["bits"] == 32:
            scratch[0] = _U0
            scratch.view(np.float32)[0] = np.float32(code)
            bits = scratch[0]
        else:
            scratch.view(np.float64)[0] = code
            bits = scratch[0]
    elif code < 0:
        scratch.view(np.int64)[0] = np.int64(code)
        unused = np.uint64(64 - n["bits"])
        bits = (scratch[0] << unused) >> unused
    else:
        bits = np.uint64(code)
    put_code_bits(n, data, first, length, bits)
    return True


@compiled
def half_to_double(bits: int) -> float:
    """The value of an IEEE 754 number of 16 bits."""
    exponent, fraction = (bits >> _HALF_BITS) & 31, bits & 1023
    if exponent == _HALF_GREATEST_EXPONENT:
        size = math.inf if fraction == 0 else math.nan
    elif exponent == 0:
        size = math.ldexp(float(fraction), _HALF_LEAST_EXPONENT - _HALF_BITS)
    else:
        size = math.ldexp(float(1024 + fraction), exponent - 25)
    return -size if bits & 0x8000 != 0 else size


@compiled
def double_to_half(value: float) -> int:
    """The IEEE 754 number of 16 bits nearest to `value`, which it holds; of two the even one."""
    size = abs(value)
    _, exponent = math.frexp(size)
    exponent = max(exponent - 1, _HALF_LEAST_EXPONENT) if size > 0.0 else _HALF_LEAST_EXPONENT
    steps = int(np.rint(math.ldexp(size, _HALF_BITS - exponent)))
    bits = steps + ((exponent - _HALF_LEAST_EXPONENT) << _HALF_BITS)  # a carry runs into the exponent, as it should
    return bits | 0x8000 if math.copysign(1.0, value) < 0 else bits
