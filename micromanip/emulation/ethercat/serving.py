"""One frame after the other in compiled code: plant on, inputs laid out, the frame through all slaves, outputs taken.

What Python has to look after, it does in the pause behind a frame, each few milliseconds (``messages.py``), and when a
slave's application has something to do: states, mailbox, EEPROM.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types

from micromanip.bus.ethercat.al_states import OP, STATUS_MASK
from micromanip.bus.ethercat.registers import AL_STATUS
from micromanip.rt.intrinsics import now_ns
from micromanip.rt.io.context import SOCKET
from micromanip.rt.io.frames import FRAME, put_code, put_value, value_of
from micromanip.rt.io.sockets import length_of, receive, received_ns, send, wait_for_any
from micromanip.rt.record import record
from micromanip.rt.records import MAX_SIGNALS, SIGNAL
from micromanip.rt.signatures import array_of

from ..amplifier import ARRIVED, note
from ..cell import PATH_ERRORS, note_errors
from ..compiled import compiled
from ..plant import PLANT, advance
from .controller import ESC, has_events, watch
from .frame import NOT_ETHERCAT, pass_frame

MOST_TERMINALS = 8
NOBODYS, COUNTS = -1, 1000
"""Of a number in the inputs: no signal of the plant, it reads 1; COUNTS + the signal whose samples it counts."""

IDLE, SERVED_SOME, HAS_EVENTS, NOBODY = 0, 1, 2, 3
"""What ``serve_on`` returns: whether it has served frames, whether an application has something to do, or that no frame
has come for `_GONE_NS`."""
_RESTED_NS = 20_000
_GONE_NS = 5_000_000

PORT = record(
    ("socket", SOCKET),
    ("waiting", "i8"),
    ("next", "i8"),
    ("first", "i8"),
    ("end", "i8"),
    ("out", "i8"),
)
"""An end of the line: `waiting` frames of a batch are served from `next` on. Slaves `first` up to `end` act on what
comes in here, which leaves at the end `out` (``line.py``)."""

SERVED = record(
    *PLANT,
    ("heard_ns", "i8"),
    ("phase_ns", "i8"),
    ("turn_ns", "i8"),
    ("follows", "i8"),
    ("refused", "i8"),
    ("frames", "i8"),
    ("bytes", "i8"),
    ("strange", "i8"),
    ("taken", "i8", (MOST_TERMINALS,)),
    ("signal", "i8", (MOST_TERMINALS, MAX_SIGNALS)),
    ("reading", "f8", (MOST_TERMINALS, MAX_SIGNALS)),
    ("output", "i8", (MOST_TERMINALS, MAX_SIGNALS)),
    ("value", "f8", (MOST_TERMINALS, MAX_SIGNALS)),
    ("arrived", ARRIVED, (MOST_TERMINALS, MAX_SIGNALS)),
    ("inputs", FRAME, (MOST_TERMINALS,)),
    ("outputs", FRAME, (MOST_TERMINALS,)),
    ("port", PORT, (2,)),
    ("rested_ns", "i8"),
    ("awake_ns", "i8"),
    ("timespec", "i8", (2,)),
)
"""Plant and line: which of the plant's signals and outputs each number is, and what came. `taken` are the outputs of a
terminal that were seen. A frame leaves `turn_ns` after it came, by the kernel's time: the way through the line.
``serve_on`` had nothing to do last at `rested_ns`, and went on last at `awake_ns`."""


_LINE = (array_of(ESC), types.float64[::1], array_of(SIGNAL))


@compiled.entry(types.boolean(array_of(SERVED), types.int64, *_LINE))
def serve(served: Any, end: int, slaves: Any, outputs: Any, signals: Any) -> bool:
    """Serve what has come in at an end, up to the first frame that gives an application something to do: whether there
    is more.

    `outputs` and `signals` are the plant's.
    """
    return serve_end(served[0], end, slaves, outputs, signals)


@compiled.entry(
    types.int64(array_of(SERVED), *_LINE, array_of(PATH_ERRORS), types.int32[:, ::1], types.int64, types.int64)
)
def serve_on(
    served: Any,
    slaves: Any,
    outputs: Any,
    signals: Any,
    errors: Any,
    poll: Any,
    until_ns: int,
    turn_due_ns: int,
) -> int:
    """Wait for frames and serve them until then, until somebody else's descriptor has something, or until Python has to
    have its turn: at `turn_due_ns`, behind a frame, for an application, or when nobody sends frames any more.

    `errors` are the plant's path errors; `poll` (n, 2) has a ``struct pollfd`` for each descriptor.
    """
    d, code = served[0], IDLE
    while True:
        before_ns = now_ns(d["timespec"])
        if before_ns >= until_ns:
            return code
        ready = wait_for_any(poll, len(poll), min(until_ns - before_ns, _GONE_NS), d["timespec"])
        after_ns = now_ns(d["timespec"])
        if after_ns - before_ns > _RESTED_NS:
            d["rested_ns"] = after_ns
        others = 1 if ready <= 0 else 0
        for i in range(len(poll)):
            if poll[i, 1] >> 16 == 0:  # the field revents
                continue
            end = 0 if poll[i, 0] == d["port"][0]["socket"]["descriptor"] else 1
            if poll[i, 0] != d["port"][end]["socket"]["descriptor"]:
                others = 1
                continue
            code = SERVED_SOME
            if serve_end(d, end, slaves, outputs, signals):
                return HAS_EVENTS
        watch(slaves, d["awake_ns"], after_ns)
        d["awake_ns"] = after_ns
        if has_events(slaves):
            return HAS_EVENTS
        if ready == 0 and after_ns - before_ns >= _GONE_NS:
            return NOBODY
        if others != 0:
            return code
        note_errors(errors[0], signals, d["time_ns"])
        if now_ns(d["timespec"]) >= turn_due_ns:
            return code


@compiled.called
def serve_end(d: Any, end: int, slaves: Any, outputs: Any, signals: Any) -> bool:
    """``serve`` by itself."""
    port = d["port"][end]
    s, out = port["socket"], d["port"][max(0, port["out"])]["socket"]
    if port["next"] >= port["waiting"]:
        port["waiting"], port["next"] = receive(s), 0
    while port["next"] < port["waiting"]:
        k = port["next"]
        port["next"] += 1
        length, data = length_of(s, k), s["received"][k]
        if length < 0:
            d["strange"] += 1
            continue
        if port["out"] < 0:
            continue
        came_ns = received_ns(s, k)
        advance(d, came_ns, outputs, signals)
        read_plant(d, slaves, signals)
        lay_out(d, slaves)
        if pass_frame(slaves[port["first"] : port["end"]], data, length, came_ns) == NOT_ETHERCAT:
            d["strange"] += 1
            continue
        if take_outputs(d, slaves, outputs):
            d["heard_ns"] = came_ns
            advance(d, came_ns, outputs, signals)
        for i in range(length):
            out["sent"][i] = data[i]
        while now_ns(s["timespec"]) < came_ns + d["turn_ns"]:
            pass
        send(out, length)
        d["frames"] += 1
        d["bytes"] += length
        if has_events(slaves):
            return True
    return False


@compiled
def read_plant(d: Any, slaves: Any, signals: Any) -> None:
    """What each number of the inputs is now."""
    for k in range(len(slaves)):
        for i in range(d["inputs"][k]["numbers"]):
            which = d["signal"][k][i]
            if which >= COUNTS:
                d["reading"][k][i] = float(signals[which - COUNTS]["sequence"])
            else:
                d["reading"][k][i] = signals[which]["value"] if which >= 0 else 1.0


@compiled
def lay_out(d: Any, slaves: Any) -> None:
    """Write `reading` into the slaves' memories; what a number can't hold is the nearest that it can, NaN the highest.

    A counter wraps.
    """
    for k in range(len(slaves)):
        f, memory = d["inputs"][k], slaves[k]["memory"]
        for i in range(f["numbers"]):
            n, value = f["number"][i], d["reading"][k][i]
            if d["signal"][k][i] >= COUNTS:
                put_code(n, memory, np.uint64(np.int64(value)))
            else:
                put_value(f, n, memory, n["high"] if math.isnan(value) else max(n["low"], min(n["high"], value)))


@compiled
def take_outputs(d: Any, slaves: Any, outputs: Any) -> bool:
    """Put what terminals in OP were given since the last time into the plant's `outputs`; whether there was any."""
    came = 0
    for k in range(len(slaves)):
        if not is_given(d, slaves, k):
            continue
        f, memory, finite = d["outputs"][k], slaves[k]["memory"], 1
        for i in range(f["numbers"]):
            d["value"][k][i] = value_of(f, f["number"][i], memory)
            finite &= 1 if math.isfinite(d["value"][k][i]) else 0
        if finite == 0:
            d["refused"] += 1
            continue
        came = 1
        if d["follows"] == 0:
            continue
        for i in range(f["numbers"]):
            if d["output"][k][i] >= 0:
                outputs[d["output"][k][i]] = d["value"][k][i]
                note(d["arrived"][k][i], d["value"][k][i])
    return came != 0


@compiled
def is_given(d: Any, slaves: Any, k: int) -> bool:
    """Whether slave `k` is in OP and has got outputs since the last time."""
    fresh = slaves[k]["outputs_count"] != d["taken"][k]
    d["taken"][k] = slaves[k]["outputs_count"]
    return fresh and d["outputs"][k]["numbers"] > 0 and int(slaves[k]["memory"][AL_STATUS]) & STATUS_MASK == OP


@compiled.entry(types.void(array_of(SERVED), array_of(ESC)))
def lay_out_readings(served: Any, slaves: Any) -> None:
    """``lay_out`` by itself: `reading` is filled."""
    lay_out(served[0], slaves)


@compiled.entry(types.boolean(array_of(SERVED), array_of(ESC), types.float64[::1]))
def outputs_taken(served: Any, slaves: Any, outputs: Any) -> bool:
    """``take_outputs`` by itself; the values are in `value`."""
    return take_outputs(served[0], slaves, outputs)
