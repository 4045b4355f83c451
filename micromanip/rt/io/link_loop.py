"""Common steps of every driver that serves a wire in the loop: receive, send what the gate allows, go to rest.

Its context has the fields of ``WIRE``; how one frame of its kind is judged is its own.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.intrinsics import now_ns, sleep_until
from micromanip.rt.jit import compiled

from .context import BATCH
from .frames import begin_frame, put_value, seal
from .link_gate import QUIET, has_sent, near, put_back, reset_to_safe, wait_for_device
from .sockets import close, receive, send

NOT_OPEN = 1
"""What ``exchange`` returns before ``open``: fault X-103."""
_ROUNDS = 4
"""System calls per cycle at most: the rest waits, so that no flood delays the loop."""


@compiled
def take(c: Any, take_one: Any, inputs: Any, deadline_ns: int) -> int:
    """Read the frames since the last cycle; how many of them acknowledge what was sent.

    ``take_one(c, k, inputs, deadline_ns)`` judges frame `k` of the socket: 1 if it acknowledges.
    """
    news = 0
    for _ in range(_ROUNDS):
        count = receive(c["socket"])
        for k in range(count):
            news += take_one(c, k, inputs, deadline_ns)
        if count < BATCH:
            break
    return news


@compiled
def send_due(c: Any, code: int, outputs: Any, deadline_ns: int) -> None:
    """Send what is due after a ``turn`` that returned `code`: `outputs`, the safe values, or nothing.

    The `outputs` that have to wait are replaced by the given values.
    """
    if code == 0:
        if not wait_for_device(c["gate"]):
            send_outputs(c, outputs, deadline_ns)
        put_back(c["gate"], outputs)
    elif c["gate"]["state"] != QUIET:
        send_outputs(c, c["gate"]["safe"], deadline_ns)


@compiled
def send_outputs(c: Any, outputs: Any, deadline_ns: int) -> None:
    """Send `outputs`, as far as the gate lets them."""
    if give(c["gate"], c["send"], c["socket"], c["counts"], outputs, deadline_ns) != 0:
        c["not_sent"] += 1


@compiled
def give(g: Any, f: Any, s: Any, counts: int, outputs: Any, deadline_ns: int) -> int:
    """Send `outputs` as a frame `f` with its count, which begins anew after `counts`: 0, or the system's error number.

    Each output is sent as it is, or as the nearest value within a step of what the device may have. An output that is
    not finite or out of range keeps its last value.
    """
    data = s["sent"]
    begin_frame(f, data, g["sent_count"] % counts)
    for i in range(g["outputs"][0]):
        value = near(g, i, outputs[i])
        if put_value(f, f["number"][i], data, value):
            g["last"][i] = value
        else:
            g["refused_values"] += 1
            g["waits"][i] = 0  # for nothing: it will never be given
            put_value(f, f["number"][i], data, g["last"][i])
    seal(f, data)
    g["sent_ns"] = deadline_ns  # also where the system did not take it: then the device is at rest the earlier
    error = send(s, f["length"])
    if error == 0:
        has_sent(g)
    return error


@compiled
def wait_for_answer(c: Any, take_all: Any, inputs: Any, deadline_ns: int) -> None:
    """Spin until what was just sent is answered, for `wait_ns` after the deadline at most; not for a silent device.

    ``take_all(c, inputs, deadline_ns)`` is the driver's ``take``. An answer that takes longer is taken in the next
    cycle, as without waiting; what came here counts in the next ``turn``.
    """
    g, timespec, end_ns = c["gate"], c["socket"]["timespec"], deadline_ns + c["wait_ns"]
    while c["answered"] < g["sent_count"] and g["answers"] > 0 and now_ns(timespec) < end_ns:
        c["news"] += take_all(c, inputs, deadline_ns)


@compiled
def begin(c: Any) -> int:
    """The socket is open already, the device at rest: begin with the safe values."""
    if c["socket"]["descriptor"] < 0:
        return NOT_OPEN
    c["opened"] = 1
    reset_to_safe(c["gate"])
    return 0


@compiled
def rest(c: Any) -> int:
    """Wait, with nothing sent, until the device's watchdog has brought it to rest."""
    c["opened"], c["closed"] = 0, 1
    timespec, still_ns = c["socket"]["timespec"], c["gate"]["sent_ns"] + c["gate"]["still_ns"]
    if still_ns > now_ns(timespec):
        sleep_until(timespec, still_ns)
    return 0


@compiled
def end(c: Any) -> int:
    """Close the socket."""
    c["opened"], c["closed"] = 0, 1
    close(c["socket"])
    return 0
