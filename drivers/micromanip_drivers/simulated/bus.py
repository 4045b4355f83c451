"""A bus between loop and cell, in virtual time: samples and outputs at its own rates, each on its way for a while.

At each tick of the input rate the readings of all sensors and lines leave together, and arrive after their latency; at
each tick of the output rate what the loop wrote last leaves, and acts after its latency. Ticks and latencies come to
whole loop periods. What only a simulation knows, and the tracker, do not go by the bus.
"""

from __future__ import annotations

import math
from typing import Any

from .records import CARRIED, CHANNELS, IN_FLIGHT, compiled
from .samples import put

_CHANNELS = len(CHANNELS)
_CARRIED = tuple(CHANNELS.index(name) for name in CARRIED)
_JUST = 1e-6
"""A tick that rounding puts so little of a period after the loop's own belongs to it."""


@compiled
def _is_tick(c: Any, rate_Hz: float, ticks: int) -> bool:
    """Whether more than `ticks` ticks of a rate have passed."""
    return math.floor(c["periods"] * c["period_ns"] * 1e-9 * rate_Hz + _JUST) > ticks


@compiled
def is_carried(c: Any, channel: int) -> bool:
    """Whether an input comes by the bus: sensors and lines do."""
    kind = channel % _CHANNELS
    return channel >= c["axes"] * _CHANNELS or kind == _CARRIED[0] or kind == _CARRIED[1] or kind == _CARRIED[2]


@compiled
def send_samples(c: Any, now_ns: int) -> None:
    """At a tick the readings of this moment leave."""
    b = c["bus"]
    if not _is_tick(c, b["input_Hz"], b["input_ticks"]):
        return
    b["input_ticks"] = math.floor(c["periods"] * c["period_ns"] * 1e-9 * b["input_Hz"] + _JUST)
    frame = b["samples"][b["samples_sent"] % IN_FLIGHT]
    b["samples_sent"] += 1
    frame["due"], frame["time_ns"] = c["periods"] + b["input_periods"], now_ns
    for k in range(c["inputs"]):
        frame["value"][k], frame["status"][k] = b["reading"][k]["value"], b["reading"][k]["status"]


@compiled
def receive_samples(c: Any, inputs: Any) -> None:
    """Leave the newest of the samples that have arrived by now, and what needs no bus, in the image."""
    b, newest = c["bus"], -1
    while b["samples_seen"] < b["samples_sent"] and b["samples"][b["samples_seen"] % IN_FLIGHT]["due"] <= c["periods"]:
        newest = b["samples_seen"] % IN_FLIGHT
        b["samples_seen"] += 1
    for k in range(c["inputs"]):
        reading = b["reading"][k]
        if not is_carried(c, k):
            if reading["sequence"] != b["passed"][k]:
                b["passed"][k] = reading["sequence"]
                put(inputs[k], reading["value"], reading["time_ns"])
        elif newest >= 0:
            frame = b["samples"][newest]
            put(inputs[k], frame["value"][k], frame["time_ns"])
            inputs[k]["status"] = frame["status"][k]


@compiled
def write(c: Any, outputs: Any) -> None:
    """Take what the loop wants written, until the next tick."""
    for k in range(c["outputs"]):
        c["bus"]["written"][k] = outputs[k]


@compiled
def send_outputs(c: Any) -> int:
    """At a tick the outputs that the loop wrote last leave; the place of the newest that act from now on, or -1."""
    b, newest = c["bus"], -1
    if _is_tick(c, b["output_Hz"], b["output_ticks"]):
        b["output_ticks"] = math.floor(c["periods"] * c["period_ns"] * 1e-9 * b["output_Hz"] + _JUST)
        frame = b["outputs"][b["outputs_sent"] % IN_FLIGHT]
        b["outputs_sent"] += 1
        frame["due"] = c["periods"] + b["output_periods"]
        for k in range(c["outputs"]):
            frame["value"][k] = b["written"][k]
    while b["outputs_seen"] < b["outputs_sent"] and b["outputs"][b["outputs_seen"] % IN_FLIGHT]["due"] <= c["periods"]:
        newest = b["outputs_seen"] % IN_FLIGHT
        b["outputs_seen"] += 1
    return newest
