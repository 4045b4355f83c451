"""The driver in the loop: judge the frame that came back, look after the line, send the next one.

The frame of one cycle is taken in the next: the loop never waits for the wire (decision 0034). It comes back through
all slaves: with the working counter of all, and all in OP, it is the acknowledgement that they have its outputs.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba import types

from micromanip.driver import CONTEXT_SIGNATURE, EXCHANGE_SIGNATURE, SIGNAL, now_ns, sleep_until
from micromanip.driver.datagrams import (
    BATCH,
    GOOD,
    WRONG_LENGTH,
    acknowledge,
    bits_at,
    close,
    code_of,
    give,
    has_rest,
    judged,
    leave_samples,
    length_of,
    lose,
    missing_before,
    receive,
    received_ns,
    taken_ns,
    turn,
)
from micromanip.driver.ethercat import OP, STATUS_MASK
from micromanip.driver.wire import MAX_OUTPUTS, QUIET

from .compiled import compiled
from .records import CONTEXT

NOT_OPEN = 1
"""What ``exchange`` returns before ``open``: fault X-103."""
_ROUNDS = 4
"""System calls a cycle at most: what more there is waits, so that nobody can hold up the loop."""
_STATUS_BYTES, _WKC_BYTES = 2, 2
_COUNTS = 1 << 32
_MAX_INPUTS = 48


@compiled
def take(c: Any, inputs: Any, deadline_ns: int) -> int:
    """Take in what has come back since the last cycle; how many frames acknowledge what was sent."""
    s, news = c["socket"], 0
    for _ in range(_ROUNDS):
        count = receive(s)
        for k in range(count):
            news += take_one(c, k, inputs, deadline_ns)
        if count < BATCH:
            break
    return news


@compiled
def take_one(c: Any, k: int, inputs: Any, deadline_ns: int) -> int:
    """Frame `k`: 1 if it acknowledges what was sent. Only a complete one, fresh, becomes samples."""
    s, f, g = c["socket"], c["receive"], c["gate"]
    c["received"] += 1
    data = s["received"][k]
    verdict = judged(f, data, length_of(s, k))
    if verdict != GOOD:
        if verdict == WRONG_LENGTH:
            c["wrong_length"] += 1
        else:
            c["not_this_frame"] += 1
        return 0
    count = int(code_of(f["counter"], data))
    missing = missing_before(c["counted"], count)
    if missing < 0:
        return 0
    broadcast = np.int64(bits_at(data, c["status_at"] + _STATUS_BYTES, _WKC_BYTES, 0))
    complete = np.int64(bits_at(data, c["working_counter_at"], _WKC_BYTES, 0)) == c["working_counter"]
    if broadcast != c["terminals"] or not complete:
        c["wrong_working_counter"] += 1
    c["al_status"] = np.int64(bits_at(data, c["status_at"], _STATUS_BYTES, 0)) & STATUS_MASK
    if c["al_status"] != OP:
        c["not_operating"] += 1
        lose(g)  # a slave has left OP, and leads its outputs by itself
        return 0
    if broadcast != c["terminals"] or not complete:
        return 0
    came_ns = received_ns(s, k)
    if f["clock"]["present"] != 0:
        came_ns = taken_ns(c["clock"], code_of(f["clock"], data), came_ns)
    leave_samples(c["samples"], f, data, inputs, missing, min(came_ns, deadline_ns))
    return acknowledge(g, (g["sent_count"] - 1 - count) % _COUNTS)


@compiled
def send_outputs(c: Any, outputs: Any, deadline_ns: int) -> None:
    """Send `outputs`, as far as the gate lets them."""
    if give(c["gate"], c["send"], c["socket"], _COUNTS, outputs, deadline_ns) != 0:
        c["not_sent"] += 1


@compiled
def exchange(c: Any, outputs: Any, inputs: Any, deadline_ns: int) -> int:
    """One exchange of the loop; what ``turn`` says, or NOT_OPEN."""
    if c["opened"] == 0:
        return NOT_OPEN
    g = c["gate"]
    code = turn(g, c["news"] + take(c, inputs, deadline_ns), outputs, deadline_ns)
    c["news"] = 0
    if code == 0:
        send_outputs(c, outputs, deadline_ns)
    elif g["state"] != QUIET:
        send_outputs(c, g["rest"], deadline_ns)
    wait_for_frame(c, inputs, deadline_ns)
    return code


@compiled
def wait_for_frame(c: Any, inputs: Any, deadline_ns: int) -> None:
    """Spin until the frame that was just sent is back, for `wait_ns` at most; what it acknowledges is of the next turn.

    One that takes longer is taken in the next cycle, as without waiting.
    """
    g, timespec, end_ns = c["gate"], c["socket"]["timespec"], deadline_ns + c["wait_ns"]
    sent = (g["sent_count"] - 1) % _COUNTS
    while c["counted"]["last"] != sent and g["state"] != QUIET and now_ns(timespec) < end_ns:
        c["news"] += take(c, inputs, deadline_ns)


_CONTEXT_POINTER = types.CPointer(numba.from_dtype(CONTEXT))


@compiled.c_function(
    EXCHANGE_SIGNATURE.return_type(
        _CONTEXT_POINTER,
        types.CPointer(types.float64),
        types.CPointer(numba.from_dtype(SIGNAL)),
        types.int64,
        types.int64,
    )
)
def exchange_c(context: Any, outputs: Any, inputs: Any, deadline_ns: Any, periods: Any) -> Any:  # noqa: ARG001
    """C entry of ``exchange``. What passed unseen doesn't matter: silence is counted in what was sent in vain."""
    return exchange(
        numba.carray(context, 1)[0],
        numba.carray(outputs, MAX_OUTPUTS),
        numba.carray(inputs, _MAX_INPUTS),
        deadline_ns,
    )


_CONTEXT_FUNCTION = CONTEXT_SIGNATURE.return_type(_CONTEXT_POINTER)


@compiled.c_function(_CONTEXT_FUNCTION)
def open_c(context: Any) -> Any:
    """The socket is open already, the slaves are in SAFEOP: begin with the safe values."""
    c = numba.carray(context, 1)[0]
    if c["socket"]["descriptor"] < 0:
        return NOT_OPEN
    c["opened"] = 1
    has_rest(c["gate"])
    return 0


@compiled.c_function(_CONTEXT_FUNCTION)
def safe_c(context: Any) -> Any:
    """Wait, with nothing sent, until the slaves' watchdogs have brought them to rest."""
    c = numba.carray(context, 1)[0]
    c["opened"], c["closed"] = 0, 1
    timespec, still_ns = c["socket"]["timespec"], c["gate"]["sent_ns"] + c["gate"]["still_ns"]
    if still_ns > now_ns(timespec):
        sleep_until(timespec, still_ns)
    return 0


@compiled.c_function(_CONTEXT_FUNCTION)
def close_c(context: Any) -> Any:
    """Let go of the socket."""
    c = numba.carray(context, 1)[0]
    c["opened"], c["closed"] = 0, 1
    close(c["socket"])
    return 0
