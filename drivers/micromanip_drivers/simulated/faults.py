"""Scheduled faults: what a sensor, a wire or the whole exchange does wrong, and when.

A fault acts on the samples that arrive while it lasts, so a slow channel is hit at its own rate; several faults of one
channel act in their order.
"""

from __future__ import annotations

import math
from typing import Any

from .records import FAULT_KINDS, compiled

_VALUE, _OFFSET, _SCALE, _FREEZE, _NAN, _STATUS, _DROP, _THIN, _SPIKE, _DRIFT, _ERROR = range(len(FAULT_KINDS))
FLAGGED = 2
"""Status of a sample that a fault of the kind `status` calls bad."""


@compiled
def _copy(of: Any, to: Any) -> None:
    to["value"], to["time_ns"] = of["value"], of["time_ns"]
    to["sequence"], to["status"] = of["sequence"], of["status"]


@compiled
def _active(c: Any, fault: Any) -> bool:
    """Whether `fault` acts now; one that a long overrun has jumped over acts once all the same."""
    if c["periods"] < fault["first_period"]:
        return False
    over = fault["end_period"] > 0 and c["periods"] >= fault["end_period"]
    return fault["begun"] == 0 or not over


@compiled
def exchange_error(c: Any) -> int:
    """The code with which this exchange fails, 0 if it works."""
    for k in range(c["faults"]):
        fault = c["fault"][k]
        if fault["kind"] == _ERROR and _active(c, fault):
            fault["begun"] = 1
            return int(fault["value"])
    return 0


@compiled
def remember(c: Any, inputs: Any) -> None:
    """Before the sensors are read: what there was, for the faults that need it."""
    for k in range(c["faults"]):
        fault = c["fault"][k]
        if fault["kind"] == _ERROR:
            continue
        signal = inputs[fault["input"]]
        fault["sequence"] = signal["sequence"]
        if fault["begun"] == 0 and _active(c, fault):
            _copy(signal, fault["held"])


@compiled
def disturb(c: Any, inputs: Any) -> None:
    """After the sensors were read: spoil the fresh samples of the channels that have a fault now."""
    for k in range(c["faults"]):
        fault = c["fault"][k]
        if fault["kind"] == _ERROR or not _active(c, fault):
            continue
        fault["begun"] = 1
        signal = inputs[fault["input"]]
        if signal["sequence"] != fault["sequence"]:
            _spoil(fault, signal)


@compiled
def _spoil(fault: Any, signal: Any) -> None:
    kind = fault["kind"]
    if kind == _VALUE:
        signal["value"] = fault["value"]
    elif kind == _OFFSET:
        signal["value"] += fault["value"]
    elif kind == _DRIFT:
        signal["value"] += fault["value"] * 1e-9 * (signal["time_ns"] - fault["held"]["time_ns"])
    elif kind == _SCALE:
        signal["value"] *= fault["value"]
    elif kind == _FREEZE:
        signal["value"] = fault["held"]["value"]
    elif kind == _NAN:
        signal["value"] = math.nan
    elif kind == _STATUS:
        signal["status"] = FLAGGED
    elif kind == _DROP:
        _copy(fault["held"], signal)
    elif kind == _THIN:
        fault["done"] += 1
        if fault["done"] < fault["value"]:
            _copy(fault["held"], signal)
        else:
            fault["done"] = 0
            _copy(signal, fault["held"])
    elif fault["done"] == 0:  # a spike is one sample
        fault["done"] = 1
        signal["value"] += fault["value"]
