"""The watchdogs of the slaves' outputs. Time in which this very process stood still passes for none of them."""

from __future__ import annotations

from typing import Any

from numba import types

from micromanip.bus.ethercat.registers import (
    SM,
    SM_BYTES,
    SM_CONTROL,
    SM_WATCHDOG,
    WATCHDOG_DIVIDER,
    WATCHDOG_SM,
    WATCHDOG_STATUS,
    WATCHDOG_TICK_NS,
)
from micromanip.rt.signatures import array_of

from ..compiled import compiled
from .controller import ESC, WATCHDOG_TURNED, has_events, number

_STOOD_NS = 10_000_000


@compiled
def has_run_out(s: Any, now_ns: int) -> bool:
    """Whether its sync manager is watched and has had no outputs for longer than the registers say."""
    m = s["memory"]
    unit_ns = (number(m, WATCHDOG_DIVIDER, 2) + 2) * WATCHDOG_TICK_NS
    patience_ns = number(m, WATCHDOG_SM, 2) * unit_ns
    watched = m[SM + s["output_manager"] * SM_BYTES + SM_CONTROL] & SM_WATCHDOG
    return watched != 0 and patience_ns > 0 and now_ns - s["outputs_ns"] > patience_ns


@compiled
def watch(slaves: Any, awake_ns: int, now_ns: int) -> None:
    """Tell each application whose watchdog runs out, or no longer has. This process went on last at `awake_ns`."""
    stood_ns = now_ns - awake_ns if now_ns - awake_ns > _STOOD_NS else 0
    for k in range(len(slaves)):
        s = slaves[k]
        s["outputs_ns"] += stood_ns
        if s["powered"] != 0 and has_run_out(s, now_ns) == (s["memory"][WATCHDOG_STATUS] & 1 != 0):
            s["events"] |= WATCHDOG_TURNED


@compiled.entry(types.boolean(array_of(ESC), types.int64, types.int64))
def pass_time(slaves: Any, awake_ns: int, now_ns: int) -> bool:
    """Watchdogs while no frame comes: whether any application has something to do."""
    watch(slaves, awake_ns, now_ns)
    return has_events(slaves)
