"""Codes to values and back: integers, signed ones, IEEE 754 numbers of 16, 32 and 64 bits, with scale and limits.

The place of a code in a frame is defined elsewhere: whole bytes in ``frames.py``, bits of a CAN frame in its driver. A
number is a record with the fields of ``CODE``; `bits` is its width, `scratch` uint64 (1,).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from micromanip.rt.jit import compiled

UNSIGNED, SIGNED, FLOATING = range(3)

CODE = (("kind", "i8"), ("scale", "f8"), ("offset", "f8"), ("lowest_code", "f8"), ("highest_code", "f8"))
"""Fields of a number of any layout: value = scale x code + offset; a code outside of its two is not sent."""

_HALF_BITS, _HALF_LEAST_EXPONENT, _HALF_GREATEST_EXPONENT = 10, -14, 31


@compiled
def value_of_code(n: Any, code: Any, bits: int, scratch: Any) -> float:
    """The value of a code (uint64, nothing above its width); not finite where a floating-point number is not."""
    if n["kind"] == FLOATING:
        if bits == 16:
            number = half_to_double(int(code))
        elif bits == 32:
            scratch.view(np.uint32)[0] = np.uint32(code)
            number = float(scratch.view(np.float32)[0])
        else:
            scratch[0] = code
            number = float(scratch.view(np.float64)[0])
    elif n["kind"] == SIGNED:
        unused = 64 - bits
        scratch[0] = code << np.uint64(unused)
        number = float(scratch.view(np.int64)[0] >> unused)
    else:
        number = float(code)
    return number * n["scale"] + n["offset"]


@compiled
def find_code(n: Any, value: float, bits: int, scratch: Any) -> bool:
    """Leave the code nearest to `value` in `scratch`; False where the limits of the number forbid it."""
    if not math.isfinite(value):
        return False
    number = (value - n["offset"]) / n["scale"]
    if n["kind"] != FLOATING:
        number = np.rint(number)
    if not n["lowest_code"] <= number <= n["highest_code"]:
        return False
    if n["kind"] == FLOATING:
        if bits == 16:
            scratch[0] = np.uint64(double_to_half(number))
        elif bits == 32:
            scratch[0] = np.uint64(0)
            scratch.view(np.float32)[0] = np.float32(number)
        else:
            scratch.view(np.float64)[0] = number
    elif n["kind"] == SIGNED:
        scratch.view(np.int64)[0] = np.int64(number)
        unused = np.uint64(64 - bits)
        scratch[0] = (scratch[0] << unused) >> unused
    else:
        scratch[0] = np.uint64(number)
    return True


@compiled
def half_to_double(code: int) -> float:
    """The value of an IEEE 754 number of 16 bits."""
    exponent, fraction = (code >> _HALF_BITS) & 31, code & 1023
    if exponent == _HALF_GREATEST_EXPONENT:
        size = math.inf if fraction == 0 else math.nan
    elif exponent == 0:
        size = math.ldexp(float(fraction), _HALF_LEAST_EXPONENT - _HALF_BITS)
    else:
        size = math.ldexp(float(1024 + fraction), exponent - 25)
    return -size if code & 0x8000 != 0 else size


@compiled
def double_to_half(value: float) -> int:
    """The IEEE 754 number of 16 bits nearest to `value`, which it holds; of two the even one."""
    size = abs(value)
    _, exponent = math.frexp(size)
    exponent = max(exponent - 1, _HALF_LEAST_EXPONENT) if size > 0.0 else _HALF_LEAST_EXPONENT
    steps = int(np.rint(math.ldexp(size, _HALF_BITS - exponent)))
    code = steps + ((exponent - _HALF_LEAST_EXPONENT) << _HALF_BITS)  # a carry runs into the exponent, as it should
    return code | 0x8000 if math.copysign(1.0, value) < 0 else code
