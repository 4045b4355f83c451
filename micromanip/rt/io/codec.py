"""Values to a frame and back, as a table says (``frames.py``): bytes, byte order, range, checksum."""

from __future__ import annotations

from typing import Any

import numpy as np

from micromanip.rt.jit import compiled

from .numbers import find_code, value_of_code

GOOD, WRONG_LENGTH, WRONG_CHECKSUM, NOT_THIS_FRAME = range(4)
"""What ``judged`` says of bytes that came."""
BAD_STATUS = -1
"""Status of samples whose device says 0, and 0 is not good; and of a sample that is no number."""

_U0, _U8, _BYTE, _ONES = np.uint64(0), np.uint64(8), np.uint64(255), np.uint64(0xFFFF_FFFF_FFFF_FFFF)


@compiled
def checksum(f: Any, data: Any) -> Any:
    """The checksum (uint64) that belongs to a frame; what stands in its own place doesn't matter."""
    c = f["checksum"]
    register = _U0
    end = f["length"] - c["size"]
    if c["reflected"] != 0:
        for i in range(c["first"], end):
            register = (register >> _U8) ^ c["table"][np.int64((register ^ np.uint64(data[i])) & _BYTE)]
    else:
        top = np.uint64(8 * c["size"] - 8)
        mask = (_BYTE << top) | ((np.uint64(1) << top) - np.uint64(1))
        for i in range(c["first"], end):
            index = np.int64(((register >> top) ^ np.uint64(data[i])) & _BYTE)
            register = ((register << _U8) & mask) ^ c["table"][index]
    return register ^ c["constant"]


@compiled
def bits_at(data: Any, at: int, size: int, big: int) -> Any:
    """An unsigned number of `size` bytes."""
    bits = _U0
    for i in range(size):
        place = at + i if big != 0 else at + size - 1 - i
        bits = (bits << _U8) | np.uint64(data[place])
    return bits


@compiled
def put_bits(data: Any, at: int, size: int, big: int, bits: Any) -> None:
    """Write the lowest `size` bytes of `bits`."""
    for i in range(size):
        place = at + size - 1 - i if big != 0 else at + i
        data[place] = np.uint8((bits >> np.uint64(8 * i)) & _BYTE)


@compiled
def packed_at(data: Any, at: int, bit: int, bits: int) -> Any:
    """An unsigned number of `bits`, at most 64, the lowest of which is number `bit` of the byte `at`."""
    code = np.uint64(data[at]) >> np.uint64(bit)
    for i in range(1, (bit + bits + 7) >> 3):
        code |= np.uint64(data[at + i]) << np.uint64(8 * i - bit)
    return code & (_ONES >> np.uint64(64 - bits))


@compiled
def put_packed(data: Any, at: int, bit: int, bits: int, code: Any) -> None:
    """Write the lowest `bits` of `code` there; all other bits of the bytes in which they lie stay."""
    for j in range(bits):
        place = bit + j
        mask = np.uint8(1 << (place & 7))
        if (code >> np.uint64(j)) & np.uint64(1) != _U0:
            data[at + (place >> 3)] |= mask
        else:
            data[at + (place >> 3)] &= ~mask


@compiled
def code_of(n: Any, data: Any) -> Any:
    """The bits of a number of a frame: of a counter, a status, a time stamp."""
    if n["size"] == 0:
        return packed_at(data, n["at"], n["bit"], n["bits"])
    return bits_at(data, n["at"], n["size"], n["big"])


@compiled
def put_code(n: Any, data: Any, code: Any) -> None:
    """Write the lowest bits of `code` to a number's place."""
    if n["size"] == 0:
        put_packed(data, n["at"], n["bit"], n["bits"], code)
    else:
        put_bits(data, n["at"], n["size"], n["big"], code)


@compiled
def judged(f: Any, data: Any, length: int) -> int:
    """Whether `length` bytes that came are such a frame: GOOD, or why not. Nothing else of them is looked at."""
    if length != f["length"]:
        return WRONG_LENGTH
    c = f["checksum"]
    if c["size"] > 0 and checksum(f, data) != bits_at(data, f["length"] - c["size"], c["size"], c["big"]):
        return WRONG_CHECKSUM
    for i in range(f["length"]):
        if f["fixed"][i] != 0 and data[i] != f["template"][i]:
            return NOT_THIS_FRAME
    return GOOD


@compiled
def value_of(f: Any, n: Any, data: Any) -> float:
    """The value of a number of a frame; not finite where a floating-point number is not."""
    return value_of_code(n, code_of(n, data), n["bits"], f["bits"])


@compiled
def status_of(f: Any, data: Any) -> int:
    """0, or the device's word for what is wrong."""
    if f["status"]["present"] == 0:
        return 0
    word = code_of(f["status"], data) & f["mask"]
    for i in range(f["goods"]):
        if word == f["good"][i]:
            return 0
    f["bits"][0] = word
    found = int(f["bits"].view(np.int64)[0])
    return found if found != 0 else BAD_STATUS


@compiled
def put_value(f: Any, n: Any, data: Any, value: float) -> bool:
    """Write `value`, rounded to the nearest code; False, with nothing written, where range or type forbid it."""
    if not n["low"] <= value <= n["high"] or not find_code(n, value, n["bits"], f["bits"]):
        return False
    put_code(n, data, f["bits"][0])
    return True


@compiled
def begin_frame(f: Any, data: Any, count: int) -> None:
    """The template, with its counter."""
    for i in range(f["length"]):
        data[i] = f["template"][i]
    n = f["counter"]
    if n["present"] != 0:
        put_code(n, data, np.uint64(count))


@compiled
def seal(f: Any, data: Any) -> None:
    """Put the checksum in its place."""
    c = f["checksum"]
    if c["size"] > 0:
        put_bits(data, f["length"] - c["size"], c["size"], c["big"], checksum(f, data))
