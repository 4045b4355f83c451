"""A frame as a table of its numbers; converts values to bytes and back, and to samples for the loop.

A frame has a fixed length. `template` is the frame before anything is written into it; where `fixed` is 1, a frame that
comes must have the template's byte. Groups are numbers that were sampled together: group 0 with every frame, another
group when its own counter has changed (such as a laser tracker's reading in a faster frame).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from micromanip.rt.jit import compiled
from micromanip.rt.record import record
from micromanip.rt.records import MAX_SIGNALS

from .numbers import CODE, find_code, value_of_code

MAX_BYTES = 1472
"""What one datagram carries over Ethernet without being cut."""
MAX_GROUPS, MAX_GOOD = 8, 8

NUMBER = record(
    ("present", "i8"),
    ("at", "i8"),
    ("size", "i8"),
    ("big", "i8"),
    ("bit", "i8"),
    ("bits", "i8"),
    *CODE,
    ("low", "f8"),
    ("high", "f8"),
)
"""A number of `size` whole bytes, or where that is 0 of `bits` from bit number `bit` of its first byte on, the lowest
first; a value outside of `low` to `high` is not sent."""

CHECKSUM = record(
    ("size", "i8"),
    ("first", "i8"),
    ("big", "i8"),
    ("rule", "i8"),
    ("constant", "u8"),
    ("table", "u8", (256,)),
)
"""A register that begins with 0 and takes in the bytes from `first` on, xor a constant: a CRC, its highest bit first or
its lowest, or a sum of what the table has for each byte. A CRC's initial value and final xor are in the constant, which
depends on the number of bytes alone."""
SHIFTED, REFLECTED, SUMMED = RULES = range(3)

GROUP = record(("counter", NUMBER), ("latency_ns", "i8"))
"""Numbers that were sampled together, `latency_ns` before the frame was finished; without a counter with each frame."""

FRAME = record(
    ("length", "i8"),
    ("template", "u1", (MAX_BYTES,)),
    ("fixed", "u1", (MAX_BYTES,)),
    ("checksum", CHECKSUM),
    ("counter", NUMBER),
    ("acknowledged", NUMBER),
    ("clock", NUMBER),
    ("status", NUMBER),
    ("mask", "u8"),
    ("good", "u8", (MAX_GOOD,)),
    ("goods", "i8"),
    ("groups", "i8"),
    ("group", GROUP, (MAX_GROUPS,)),
    ("numbers", "i8"),
    ("number", NUMBER, (MAX_SIGNALS,)),
    ("group_of", "i8", (MAX_SIGNALS,)),
    ("bits", "u8", (1,)),
)
"""One kind of frame; `acknowledged` is the count of the frame that its sender has taken last, `clock` the device's time
stamp, `bits` scratch for the bits of a number."""

SAMPLES = record(
    ("group_count", "i8", (MAX_GROUPS,)),
    ("group_known", "i8", (MAX_GROUPS,)),
    ("missing", "i8", (MAX_GROUPS,)),
    ("lost", "i8", (MAX_SIGNALS,)),
)
"""Where the counter of each group stands. ``missing`` is scratch: samples of each group that are missing before the one
that has come, -1 for none. ``lost`` are those of each number that never came, since the start."""

GOOD, WRONG_LENGTH, WRONG_CHECKSUM, NOT_THIS_FRAME = range(4)
"""Results of ``judged``."""
BAD_STATUS = -1
"""Status of samples whose device reports 0 if 0 is not good, and of a sample that is no number."""

_U0, _U8, _BYTE, _ONES = np.uint64(0), np.uint64(8), np.uint64(255), np.uint64(0xFFFF_FFFF_FFFF_FFFF)


@compiled
def checksum(f: Any, data: Any) -> Any:
    """The checksum (uint64) that belongs to a frame; what stands in its own place doesn't matter."""
    c = f["checksum"]
    register, top = _U0, np.uint64(8 * c["size"] - 8)
    mask = (_BYTE << top) | ((np.uint64(1) << top) - np.uint64(1))
    for i in range(c["first"], f["length"] - c["size"]):
        byte = np.uint64(data[i])
        if c["rule"] == REFLECTED:
            register = (register >> _U8) ^ c["table"][np.int64((register ^ byte) & _BYTE)]
        elif c["rule"] == SHIFTED:
            register = ((register << _U8) & mask) ^ c["table"][np.int64(((register >> top) ^ byte) & _BYTE)]
        else:
            register = (register + c["table"][data[i]]) & mask
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
    """Whether `length` received bytes are such a frame: GOOD, or why not."""
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
    """0, or the device's code for an error."""
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


@compiled
def leave_samples(
    s: Any, f: Any, data: Any, inputs: Any, lost: Any, missing: int, time_ns: int, passed: int = 0
) -> None:
    """The values of a fresh frame of `time_ns`, `missing` after the one before, as samples.

    `passed` samples of group 0 arrived together with this one and are superseded. Missing samples are added to `lost`
    of each number.
    """
    for g in range(f["groups"]):
        s["missing"][g] = missing if g == 0 else missing_of_group(s, f, g, data)
    status = status_of(f, data)
    for i in range(f["numbers"]):
        g = f["group_of"][i]
        if s["missing"][g] < 0:
            continue
        value = value_of(f, f["number"][i], data)
        signal = inputs[i]
        signal["value"], signal["time_ns"] = value, time_ns - f["group"][g]["latency_ns"]
        signal["status"] = status if math.isfinite(value) or status != 0 else BAD_STATUS
        signal["sequence"] += 1 + s["missing"][g] + (passed if g == 0 else 0)
        lost[i] += s["missing"][g]


@compiled
def missing_of_group(s: Any, f: Any, g: int, data: Any) -> int:
    """Samples missing before the one that the frame brings of a slower group; -1 where it brings none."""
    n = f["group"][g]["counter"]
    count = np.int64(code_of(n, data))
    ahead = (count - s["group_count"][g]) % (1 << n["bits"])
    known = s["group_known"][g] != 0
    s["group_count"][g], s["group_known"][g] = count, 1
    return ahead - 1 if known else 0
