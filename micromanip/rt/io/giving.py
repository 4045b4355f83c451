"""A frame of outputs that leaves through the gate (``link_gate.py``)."""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled

from .codec import begin_frame, put_value, seal
from .datagrams import send
from .link_gate import has_sent, near


@compiled
def give(g: Any, f: Any, s: Any, counts: int, outputs: Any, deadline_ns: int) -> int:
    """Send `outputs` as a frame `f` with its count, which begins anew after `counts`: 0, or the system's error number.

    Each is what it is, or what is next to it and near enough to what the device has. One that is not finite or out of
    range stays as it was.
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
