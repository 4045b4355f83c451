"""The driver in the loop: take what came, look after the link, send what the loop has decided.

The answer to the datagram of one cycle is taken in the next, unless the loop waits for it. It says which datagram the
device has acted on last; what may be sent then is the gate's to say (``micromanip.driver.datagrams``: ``turn``).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from micromanip.driver import entries
from micromanip.driver.datagrams import (
    GOOD,
    NOT_OPEN,
    OLD,
    RESTARTED,
    WRONG_CHECKSUM,
    WRONG_LENGTH,
    acknowledge,
    begin,
    code_of,
    end,
    forget_clock,
    is_from_peer,
    judged,
    leave_samples,
    length_of,
    missing_before,
    on_link_lost,
    received_ns,
    rest,
    send_due,
    take,
    taken_ns,
    turn,
    wait_for_answer,
)

from .records import CONTEXT, compiled


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
        on_link_lost(c["gate"])
        return 0
    came_ns = received_ns(s, k)
    if f["clock"]["present"] != 0:
        came_ns = taken_ns(c["clock"], code_of(f["clock"], data), came_ns)
    leave_samples(c["samples"], f, data, inputs, c["samples"]["lost"], missing, min(came_ns, deadline_ns))
    return acknowledged(c, data)


@compiled
def acknowledged(c: Any, data: Any) -> int:
    """1 where the answer says that the device has acted on a datagram later than was known.

    One that doesn't say which, of a device that is given nothing, answers the last.
    """
    g, n = c["gate"], c["receive"]["acknowledged"]
    behind = 0 if n["present"] == 0 else (g["sent_count"] - 1 - np.int64(code_of(n, data))) % c["counts"]
    c["answered"] = g["sent_count"] - behind
    return acknowledge(g, behind)


@compiled
def take_all(c: Any, inputs: Any, deadline_ns: int) -> int:
    """What has come since the last time; how many answers acknowledge what was sent."""
    return take(c, take_one, inputs, deadline_ns)


@compiled
def exchange(c: Any, outputs: Any, inputs: Any, deadline_ns: int, periods: int) -> int:  # noqa: ARG001
    """One exchange of the loop; what ``turn`` says, or NOT_OPEN.

    What passed unseen doesn't matter: silence is counted in what was sent in vain.
    """
    if c["opened"] == 0:
        return NOT_OPEN
    news = c["news"] + take_all(c, inputs, deadline_ns)
    code = turn(c["gate"], news, outputs, deadline_ns)
    c["news"] = 0
    send_due(c, code, outputs, deadline_ns)
    wait_for_answer(c, take_all, inputs, deadline_ns)
    return code


ENTRIES = entries(compiled, CONTEXT, begin, exchange, rest, end)
