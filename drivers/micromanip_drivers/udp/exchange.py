"""The driver in the loop: take what came, look after the link, send what the loop has decided.

    FOLLOWING   the device is given the loop's outputs
    QUIET       the link was lost: nothing is sent, until the device's own watchdog has surely brought it to rest
    RESTING     it is given its safe values, until it answers and the loop itself asks for just these: nothing steps

The answer to the datagram of one cycle is taken in the next: the loop never waits for the wire. It says which datagram
the device has acted on last. So it is known between which values lies what the device has, and the next value is within
a step of them all: however many were lost on the way, nothing jumps. ``bus/safe_state.py`` does the same for buses.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numba import types

from micromanip.driver import CONTEXT_SIGNATURE, EXCHANGE_SIGNATURE, SIGNAL, now_ns, sleep_until
from micromanip.driver.datagrams import (
    BAD_STATUS,
    BATCH,
    GOOD,
    OLD,
    RESTARTED,
    WRONG_CHECKSUM,
    WRONG_LENGTH,
    begin_frame,
    close,
    code_of,
    forget_clock,
    is_from_peer,
    judged,
    length_of,
    missing_before,
    put_value,
    receive,
    received_ns,
    seal,
    send,
    status_of,
    taken_ns,
    value_of,
)
from micromanip.driver.wire import DOWN, TAKEN

from .compiled import compiled
from .records import ANSWERS, CONTEXT, FOLLOWING, MAX_OUTPUTS, QUIET, RECENT, RESTING

NOT_OPEN = 1
"""What ``exchange`` returns before ``open``: fault X-103."""
_ROUNDS = 4
"""System calls a cycle at most: what more there is waits, so that nobody can hold up the loop."""
_EQUAL = 1e-9
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
        lose(c)
        return 0
    came_ns = received_ns(s, k)
    if f["clock"]["present"] != 0:
        came_ns = taken_ns(c["clock"], code_of(f["clock"], data), came_ns)
    leave_samples(c, data, inputs, missing, min(came_ns, deadline_ns))
    return acknowledge(c, data)


@compiled
def acknowledge(c: Any, data: Any) -> int:
    """1 where the answer says that the device has acted on a datagram later than was known.

    Then it has this one's values, or those of one that was sent after it.
    """
    n = c["receive"]["acknowledged"]
    if n["present"] == 0:
        return 1
    behind = (c["sent_count"] - 1 - np.int64(code_of(n, data))) % c["counts"]
    last = c["sent_count"] - 1 - behind
    if behind >= RECENT or last < c["acknowledged"]:
        return 0
    c["acknowledged"] = last + 1
    for i in range(c["outputs"]):
        c["lowest"][i] = c["highest"][i] = c["recent"][last % RECENT][i]
        for k in range(last + 1, c["sent_count"]):
            may_have(c, i, c["recent"][k % RECENT][i])
    return 1


@compiled
def may_have(c: Any, i: int, value: float) -> None:
    """Count `value` of output `i` among what the device may have."""
    c["lowest"][i], c["highest"][i] = min(c["lowest"][i], value), max(c["highest"][i], value)


@compiled
def has_rest(c: Any) -> None:
    """From now on the device has its safe values, and only what it is sent from now on counts as acknowledged."""
    c["state"], c["answers"], c["acknowledged"] = RESTING, 0, c["sent_count"]
    for i in range(c["outputs"]):
        c["lowest"][i] = c["highest"][i] = c["rest"][i]


@compiled
def leave_samples(c: Any, data: Any, inputs: Any, missing: int, time_ns: int) -> None:
    """The values of a fresh datagram of `time_ns`, `missing` after the one before, as samples."""
    f = c["receive"]
    for g in range(f["groups"]):
        c["missing"][g] = missing if g == 0 else missing_of_group(c, g, data)
    status = status_of(f, data)
    for i in range(f["numbers"]):
        g = f["group_of"][i]
        if c["missing"][g] < 0:
            continue
        value = value_of(f, f["number"][i], data)
        signal = inputs[i]
        signal["value"], signal["time_ns"] = value, time_ns - f["group"][g]["latency_ns"]
        signal["status"] = status if math.isfinite(value) or status != 0 else BAD_STATUS
        signal["sequence"] += 1 + c["missing"][g]


@compiled
def missing_of_group(c: Any, g: int, data: Any) -> int:
    """Samples missing before the one that the datagram brings of a slower group; -1 where it brings none."""
    n = c["receive"]["group"][g]["counter"]
    count = np.int64(code_of(n, data))
    ahead = (count - c["group_count"][g]) % (1 << (8 * n["size"]))
    known = c["group_known"][g] != 0
    c["group_count"][g], c["group_known"][g] = count, 1
    return ahead - 1 if known else 0


@compiled
def lose(c: Any) -> None:
    """The link is lost: nothing more is sent, until the device is at rest."""
    if c["state"] == FOLLOWING:
        c["state"] = QUIET
        c["losses"] += 1
    c["answers"] = 0


@compiled
def give(c: Any, outputs: Any, deadline_ns: int) -> None:
    """Send `outputs`, or what is next to them and near enough to what the device has.

    One that is not finite or out of range stays as it was.
    """
    f, data = c["send"], c["socket"]["sent"]
    begin_frame(f, data, c["sent_count"] % c["counts"])
    for i in range(c["outputs"]):
        value = near(c, i, outputs[i])
        if put_value(f, f["number"][i], data, value):
            c["given"][i] = value
        else:
            c["refused_values"] += 1
            put_value(f, f["number"][i], data, c["given"][i])
    seal(f, data)
    c["sent_ns"] = deadline_ns  # also where the system did not take it: then the device is at rest the earlier
    if send(c["socket"], f["length"]) == 0:
        for i in range(c["outputs"]):
            c["recent"][c["sent_count"] % RECENT][i] = c["given"][i]
            may_have(c, i, c["given"][i])
        c["sent_count"] += 1
    else:
        c["not_sent"] += 1


@compiled
def near(c: Any, i: int, value: float) -> float:
    """What comes nearest to `value` and is within a step of all that the device may have; NaN stays NaN."""
    step = c["step"][i]
    if c["highest"][i] - step <= value <= c["lowest"][i] + step or not math.isfinite(value):
        return value
    c["held_back"] += 1
    return min(max(value, c["highest"][i] - step), c["lowest"][i] + step)


@compiled
def asks_for_rest(c: Any, outputs: Any) -> bool:
    """Whether the loop wants every voltage at its safe value."""
    away = 0
    for i in range(c["outputs"]):
        if c["switch"][i] == 0 and not abs(outputs[i] - c["rest"][i]) <= _EQUAL:
            away += 1
    return away == 0


@compiled
def exchange(c: Any, outputs: Any, inputs: Any, deadline_ns: int) -> int:
    """One exchange of the loop; 0, DOWN, TAKEN, or NOT_OPEN."""
    if c["opened"] == 0:
        return NOT_OPEN
    if take(c, inputs, deadline_ns) > 0:
        c["unanswered_in_a_row"] = 0
        c["answers"] += 1
        c["begun"] += 1 if c["answers"] == ANSWERS else 0
    else:
        c["unanswered_in_a_row"] += 1
        c["unanswered"] += 1
    silent = c["unanswered_in_a_row"] > c["silent_cycles"]
    away_ns = deadline_ns - c["sent_ns"]
    if silent or (c["state"] == FOLLOWING and away_ns > c["watchdog_ns"]):
        lose(c)
    if c["state"] == QUIET:
        if away_ns < c["still_ns"]:
            return DOWN
        has_rest(c)
    up = c["answers"] >= ANSWERS
    if c["state"] == RESTING and up and asks_for_rest(c, outputs):
        c["state"] = FOLLOWING
    if c["state"] == FOLLOWING:
        give(c, outputs, deadline_ns)
        return 0
    give(c, c["rest"], deadline_ns)
    return TAKEN if up else DOWN


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
    has_rest(c)
    return 0


@compiled.c_function(_CONTEXT_FUNCTION)
def safe_c(context: Any) -> Any:
    """Wait, with nothing sent, until the device's watchdog has brought it to rest."""
    c = numba.carray(context, 1)[0]
    c["opened"] = 0
    timespec = c["socket"]["timespec"]
    if c["sent_ns"] + c["still_ns"] > now_ns(timespec):
        sleep_until(timespec, c["sent_ns"] + c["still_ns"])
    return 0


@compiled.c_function(_CONTEXT_FUNCTION)
def close_c(context: Any) -> Any:
    """Let go of the socket."""
    c = numba.carray(context, 1)[0]
    c["opened"] = 0
    close(c["socket"])
    return 0
