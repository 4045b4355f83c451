"""One datagram after the other in compiled code: command in, plant on, answer out, while nothing is amiss.

What Python has to look after, it does in the pause behind a datagram, each few milliseconds (``messages.py``):
watchdog, path error, figures.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types

from micromanip.rt.io.context import SOCKET
from micromanip.rt.io.counting import COUNTED, OLD, missing_before
from micromanip.rt.io.frames import FRAME, MAX_GROUPS, begin_frame, code_of, judged, put_bits, put_value, seal, value_of
from micromanip.rt.io.sockets import length_of, receive, send_back
from micromanip.rt.record import record
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.rt.signatures import array_of

from ..amplifier import ARRIVED, note
from ..compiled import compiled
from ..plant import PLANT, advance

BAD = -1000
"""What ``understand`` returns for what is no command."""

SERVED = record(
    *PLANT,
    ("heard_ns", "i8"),
    ("count", "i8"),
    ("counts", "i8"),
    ("unit_ns", "f8"),
    ("output", "i8", (MAX_OUTPUTS,)),
    ("value", "f8", (MAX_OUTPUTS,)),
    ("arrived", ARRIVED, (MAX_OUTPUTS,)),
    ("signal", "i8", (MAX_SIGNALS,)),
    ("reading", "f8", (MAX_SIGNALS,)),
    ("samples", "i8", (MAX_GROUPS,)),
    ("group_signal", "i8", (MAX_GROUPS,)),
    ("received", "i8"),
    ("not_understood", "i8"),
    ("refused", "i8"),
    ("sent", "i8"),
    ("counted", COUNTED),
    ("commands", FRAME),
    ("answers", FRAME),
    ("socket", SOCKET),
)
"""Device and plant: the index of each output and signal in it; -1 for an output that nobody has, and for a signal
that is not the plant's: it reads 1."""


@compiled.entry(types.void(array_of(SERVED), types.float64[::1], array_of(SIGNAL)))
def serve(devices: Any, outputs: Any, signals: Any) -> None:
    """Take in what has come, act on each command and answer it; `outputs` and `signals` are the plant's."""
    d = devices[0]
    count = receive(d["socket"])
    for k in range(count):
        if take_command(d, k, outputs):
            advance(d, d["socket"]["now_ns"], outputs, signals)
            say(d, k, signals)


@compiled
def take_command(d: Any, k: int, outputs: Any) -> bool:
    """Whether datagram `k` is a command; what is not finite is refused, what was overtaken does nothing."""
    f, data = d["commands"], d["socket"]["received"][k]
    if judged(f, data, length_of(d["socket"], k)) != 0:
        d["not_understood"] += 1
        return False
    d["received"] += 1
    for i in range(f["numbers"]):
        d["value"][i] = value_of(f, f["number"][i], data)
        if not math.isfinite(d["value"][i]):
            d["refused"] += 1
            return True
    if missing_before(d["counted"], int(code_of(f["counter"], data))) != OLD:
        d["heard_ns"] = d["socket"]["now_ns"]
        for i in range(f["numbers"]):
            if d["output"][i] >= 0:
                outputs[d["output"][i]] = d["value"][i]
                note(d["arrived"][i], d["value"][i])
    return True


@compiled
def say(d: Any, k: int, signals: Any) -> None:
    """Answer datagram `k` with what the plant reads now."""
    f, data = d["answers"], d["socket"]["sent"]
    d["count"] = (d["count"] + 1) % d["counts"]
    for i in range(f["numbers"]):
        d["reading"][i] = signals[d["signal"][i]]["value"] if d["signal"][i] >= 0 else 1.0
    for g in range(1, f["groups"]):
        d["samples"][g] = signals[d["group_signal"][g]]["sequence"] if d["group_signal"][g] >= 0 else 0
    write_answer(d, data)
    if send_back(d["socket"], k, f["length"]) == 0:
        d["sent"] += 1


@compiled
def write_answer(d: Any, data: Any) -> None:
    """The answer number `count` with `reading`, and with the count of each group's `samples`.

    A value that its number can't hold is the nearest that it can, NaN the highest where the type has none.
    """
    f, values, samples = d["answers"], d["reading"], d["samples"]
    begin_frame(f, data, d["count"])
    if f["acknowledged"]["present"] != 0:
        n = f["acknowledged"]
        put_bits(data, n["at"], n["size"], n["big"], np.uint64(d["counted"]["last"]))
    if f["clock"]["present"] != 0:
        n = f["clock"]
        put_bits(data, n["at"], n["size"], n["big"], np.uint64(int(d["time_ns"] / d["unit_ns"])))
    for g in range(1, f["groups"]):
        n = f["group"][g]["counter"]
        put_bits(data, n["at"], n["size"], n["big"], np.uint64(samples[g]))
    for i in range(f["numbers"]):
        n = f["number"][i]
        value = n["high"] if math.isnan(values[i]) else max(n["low"], min(n["high"], values[i]))
        put_value(f, n, data, value)
    seal(f, data)


@compiled.entry(types.int64(array_of(SERVED), types.uint8[::1], types.int64))
def understand(devices: Any, data: Any, length: int) -> int:
    """A command of `length` bytes by itself: its values are in `value`; BAD, or see ``missing_before``."""
    d = devices[0]
    f = d["commands"]
    if judged(f, data, length) != 0:
        return BAD
    for i in range(f["numbers"]):
        d["value"][i] = value_of(f, f["number"][i], data)
    return missing_before(d["counted"], int(code_of(f["counter"], data)))


@compiled.entry(types.void(array_of(SERVED)))
def compose(devices: Any) -> None:
    """The next answer by itself, with `reading` and `samples`; it is in the socket's `sent`."""
    write_answer(devices[0], devices[0]["socket"]["sent"])
