"""The driver in the loop: take what came, look after the link, send what the loop has decided.

The answer to the datagram of one cycle is taken in the next: the loop never waits for the wire. It says which datagram
the device has acted on last; what may be sent then is the gate's to say (``micromanip.driver.datagrams``: ``turn``).
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
    OLD,
    RESTARTED,
    WRONG_CHECKSUM,
    WRONG_LENGTH,
    acknowledge,
    close,
    code_of,
    forget_clock,
    give,
    has_rest,
    is_from_peer,
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
from micromanip.driver.wire import MAX_OUTPUTS, QUIET

from .compiled import compiled
from .records import CONTEXT

NOT_OPEN = 1
"""What ``exchange`` returns before ``open``: fault X-103."""
_ROUNDS = 4
"""System calls a cycle at most: what more there is waits, so that nobody can hold up the loop."""
_MAX_INPUTS = 48


@compiled
def take(c: Any, inputs: Any, deadline_ns: int) -> int:
    """Take in what has come since the last cycle; how many datagrams acknowledge what was sent."""
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
    """Datagram `k`: 1 if it acknowledges what was sent. Only a fresh one of the device becomes samples."""
    s, f = c["socket"], c["receive"]
    c["received"] += 1
    if not is_from_peer(s, k):
        c["strangers"] += 1
        return 0
    data = s["received"][k]
    verdict = judged(f, data, length_of(s, k))
    if verdict != GOOD:
        if verdict == WRONG_LENGTH:
            c["wrong_length"] += 1
        elif verdict == WRONG_CHECKSUM:
            c["wrong_checksum"] += 1
        else:
            c["not_this_datagram"] += 1
        return 0
    missing = missing_before(c["counted"], int(code_of(f["counter"], data)))
    if missing == OLD:
        return 0
    if missing == RESTARTED:
        forget_clock(c["clock"])
        lose(c["gate"])
        return 0
    came_ns = received_ns(s, k)
    if f["clock"]["present"] != 0:
        came_ns = taken_ns(c["clock"], code_of(f["clock"], data), came_ns)
    leave_samples(c["samples"], f, data, inputs, missing, min(came_ns, deadline_ns))
    return acknowledged(c, data)


@compiled
def acknowledged(c: Any, data: Any) -> int:
    """1 where the answer says that the device has acted on a datagram later than was known."""
    n = c["receive"]["acknowledged"]
    if n["present"] == 0:
        return 1
    g = c["gate"]
    return acknowledge(g, (g["sent_count"] - 1 - np.int64(code_of(n, data))) % c["counts"])


@compiled
def send_outputs(c: Any, outputs: Any, deadline_ns: int) -> None:
    """Send `outputs`, as far as the gate lets them."""
    if give(c["gate"], c["send"], c["socket"], c["counts"], outputs, deadline_ns) != 0:
        c["not_sent"] += 1


@compiled
def exchange(c: Any, outputs: Any, inputs: Any, deadline_ns: int) -> int:
    """One exchange of the loop; what ``turn`` says, or NOT_OPEN."""
    if c["opened"] == 0:
        return NOT_OPEN
    g = c["gate"]
    code = turn(g, take(c, inputs, deadline_ns), outputs, deadline_ns)
    if code == 0:
        send_outputs(c, outputs, deadline_ns)
    elif g["state"] != QUIET:
        send_outputs(c, g["rest"], deadline_ns)
    return code


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
    """The socket is open already (``opening.py``): begin with the safe values."""
    c = numba.carray(context, 1)[0]
    if c["socket"]["descriptor"] < 0:
        return NOT_OPEN
    c["opened"] = 1
    has_rest(c["gate"])
    return 0


@compiled.c_function(_CONTEXT_FUNCTION)
def safe_c(context: Any) -> Any:
    """Wait, with nothing sent, until the device's watchdog has brought it to rest."""
    c = numba.carray(context, 1)[0]
    c["opened"] = 0
    timespec, still_ns = c["socket"]["timespec"], c["gate"]["sent_ns"] + c["gate"]["still_ns"]
    if still_ns > now_ns(timespec):
        sleep_until(timespec, still_ns)
    return 0


@compiled.c_function(_CONTEXT_FUNCTION)
def close_c(context: Any) -> Any:
    """Let go of the socket."""
    c = numba.carray(context, 1)[0]
    c["opened"] = 0
    close(c["socket"])
    return 0
