"""Voltages that have to wait: what the loop asks for is not yet what the device may be given.

On a wire whose frames come back late a device may still have any of the voltages of the last frames, and gets none that
is further than a step from one of them (``wire/gate.py``): so it is slower than the limiter says, by as many times as
frames are on their way. A loop that does not know takes what it asked for to be in force, asks for more, and swings
from end to end behind a voltage that hardly moves. The same behind a bus whose worker stands still. So the driver, or
the bus' exchange, puts what was given in place of what was asked, and an axis that sees it goes no further in that
direction, as at an end of its range: neither set-point nor voltage. Back they go as ever. Its PID waits as well, and
each such cycle counts as one that was missed (``outrun.py``).
"""

from __future__ import annotations

from typing import Any

from .jit import compiled
from .outrun import AT_ONCE, saw_late
from .record import Record


@compiled
def see_waiting(p: Record, s: Record, outputs: Any) -> None:
    """After an exchange: on which axes `outputs`, what the devices were given, is not what was asked for."""
    for i in range(p["axes"]):
        a = s["axis"][i]
        lacking_V = a["voltage_V"] - outputs[p["axis"][i]["voltage"]]
        wait(a, int(lacking_V > 0.0) - int(lacking_V < 0.0))


@compiled
def wait(s: Record, direction: int) -> None:
    """Count the cycles for which the device has had less (1) or more (-1: downwards) than was asked; 0: neither."""
    before = s["waits"]
    s["waits"] = before + direction if before * direction > 0 else direction


@compiled
def waits(s: Record) -> bool:
    """Whether the axis has to wait; of one wait the first cycles count as missing, as those of any gap do."""
    if s["waits"] == 0:
        return False
    saw_late(s, 1 if abs(s["waits"]) <= AT_ONCE else 0)
    return True


@compiled
def no_further(s: Record, before: float, value: float) -> float:
    """`value`, but where the axis waits not beyond the one `before` in that direction."""
    if s["waits"] == 0:
        return value
    return min(before, value) if s["waits"] > 0 else max(before, value)
