"""The plant as compiled code advances it that serves a device's port (``plant.PlantInRealTime``)."""

from __future__ import annotations

from typing import Any

from micromanip.rt.intrinsics import call_exchange

from .compiled import compiled
from .plant import MOST_PERIODS, PERIOD_NS, PlantInRealTime

PLANT = (("exchange", "i8"), ("context", "i8"), ("period_ns", "i8"), ("most_periods", "i8"), ("time_ns", "i8"))
"""Fields of a served device: where the plant's function and context are, and how far its time has come."""


def fill_plant(d: Any, plant: PlantInRealTime) -> None:
    """Let compiled code find `plant`."""
    d["exchange"], d["context"] = plant.addresses
    d["period_ns"], d["most_periods"] = PERIOD_NS, MOST_PERIODS


@compiled
def advance(d: Any, now_ns: int, outputs: Any, signals: Any) -> None:
    """Let the plant's periods up to now pass with what was in force, then put in force what is in `outputs`."""
    periods = max(0, (now_ns - d["time_ns"]) // d["period_ns"])
    d["time_ns"] += periods * d["period_ns"]
    passed = min(periods, d["most_periods"])
    call_exchange(d["exchange"], d["context"], outputs.ctypes.data, signals.ctypes.data, d["time_ns"], passed)
