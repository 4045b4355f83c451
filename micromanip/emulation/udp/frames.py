"""The device's side of the tables: a command to values, values to an answer, each one call of compiled code."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types

from micromanip.rt.jit import Compiler
from micromanip.rt.signatures import array_of
from micromanip.rt.wire.codec import begin_frame, code_of, judged, put_bits, put_value, seal, value_of
from micromanip.rt.wire.counting import COUNTED, missing_before
from micromanip.rt.wire.records import FRAME

compiled = Compiler(__file__)

_FRAMES, _COUNTED = array_of(FRAME), array_of(COUNTED)
_BYTES, _VALUES, _COUNTS = types.uint8[::1], types.float64[::1], types.int64[::1]
BAD = -1000
"""What ``take_command`` returns for what is no command."""


@compiled.entry(types.int64(_FRAMES, _COUNTED, _BYTES, types.int64, _VALUES))
def take_command(frames: Any, counted: Any, data: Any, length: int, values: Any) -> int:
    """The values of a command of `length` bytes; BAD, or commands missing before it, see ``missing_before``."""
    f = frames[0]
    if judged(f, data, length) != 0:
        return BAD
    for i in range(f["numbers"]):
        values[i] = value_of(f, f["number"][i], data)
    return missing_before(counted[0], np.int64(code_of(f["counter"], data)))


@compiled.entry(types.void(_FRAMES, types.int64, types.int64, _COUNTS, _VALUES, _BYTES))
def write_answer(frames: Any, count: int, stamp: int, samples: Any, values: Any, data: Any) -> None:
    """Answer number `count` with `values`; `stamp` is the device's time, `samples` has the count of each group.

    A value that its number can't hold is the nearest that it can, NaN the highest where the type has none.
    """
    f = frames[0]
    begin_frame(f, data, count)
    if f["clock"]["present"] != 0:
        n = f["clock"]
        put_bits(data, n["at"], n["size"], n["big"], np.uint64(stamp))
    for g in range(f["groups"]):
        n = f["group"][g]["counter"]
        if n["present"] != 0:
            put_bits(data, n["at"], n["size"], n["big"], np.uint64(samples[g]))
    for i in range(f["numbers"]):
        n = f["number"][i]
        value = n["high"] if math.isnan(values[i]) else max(n["low"], min(n["high"], values[i]))
        put_value(f, n, data, value)
    seal(f, data)
