"""Digital outputs of the cell: amplifier on, reset, feed-hold, heartbeat."""

from __future__ import annotations

from typing import Any

from .jit import compiled
from .record import Record
from .states import ARMING, HOLDING, NO_FAULT, RAMPING, READY, TRACKING


@compiled
def asks_feed_hold(s: Record) -> bool:
    """Whether the machine is asked to stop feeding: the path is not corrected, or not for long."""
    return s["state"] == HOLDING or s["fault"] != NO_FAULT


@compiled
def is_enabled(s: Record) -> bool:
    """Whether the amplifier is asked to be on."""
    state = s["state"]
    return state in (ARMING, TRACKING, HOLDING, RAMPING)


@compiled
def is_reset(s: Record) -> bool:
    """Whether the amplifier is asked to forget its fault: for a while after the operator's reset, and at rest only."""
    return s["state"] == READY and s["cycle"] < s["reset_until_cycle"]


@compiled
def switch(p: Record, s: Record, outputs: Any) -> None:
    """Digital outputs: amplifier on and reset, feed-hold asked of the machine, heartbeat of the loop."""
    if p["amplifier_enable"] >= 0:
        outputs[p["amplifier_enable"]] = 1.0 if is_enabled(s) else 0.0
    if p["amplifier_reset"] >= 0:
        outputs[p["amplifier_reset"]] = 1.0 if is_reset(s) else 0.0
    if p["feed_hold"] >= 0:
        outputs[p["feed_hold"]] = 1.0 if asks_feed_hold(s) else 0.0
    if p["heartbeat"] >= 0:
        outputs[p["heartbeat"]] = float(s["cycle"] // p["heartbeat_cycles"] % 2)
