"""Which limits a run meets, and when first: those that only hold something back, and what is watched."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from micromanip.faults import KINDS
from micromanip.rt.states import NO_FAULT

from .window import Window

_NEARLY = 1.0 - 1e-9


class Met(NamedTuple):
    """A limit that was met: its name and value, for how many cycles, and when first from the recording's beginning."""

    axis: str
    limit: str
    value: str
    cycles: int
    first_s: float


def limits_met(window: Window, parameters: NDArray[Any], rows: NDArray[Any], begin: int) -> list[Met]:
    """The limits of `parameters` (1,) that `rows` (n,), of the window from row `begin` on, meet; by the time."""
    found: list[Met] = []
    per_ms = 1e6 / window.period_ns

    def add(axis: str, limit: str, value: str, met: NDArray[np.bool_]) -> None:
        if met.any():
            found.append(Met(axis, limit, value, int(met.sum()), window.at_s(begin + int(np.argmax(met)))))

    def steps(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.abs(np.diff(values, prepend=values[:1]))

    for i, axis in enumerate(window.axes):
        p, row = parameters[0]["axis"][i], rows["axis"][:, i]
        limiter, voltage, setpoint = p["limiter"], row["voltage_V"], row["setpoint_um"]
        low, high = float(limiter["low_V"]), float(limiter["high_V"])
        add(axis, "voltage", f"{low:g}..{high:g} V", (voltage <= low) | (voltage >= high))
        slew = float(limiter["slew_V"])
        add(axis, "voltage slew", f"{slew * per_ms:g} V/ms", steps(voltage) >= slew * _NEARLY)
        low, high = float(p["setpoint_low_um"]), float(p["setpoint_high_um"])
        add(axis, "stroke", f"{low:g}..{high:g} um", (setpoint <= low) | (setpoint >= high))
        slew = float(p["setpoint_slew_um"])
        add(axis, "set-point slew", f"{slew * per_ms:g} um/ms", steps(setpoint) >= slew * _NEARLY)
        for number, kind in KINDS.items():
            add(axis, kind.name.lower().replace("_", " "), kind.code, row["conditions"] & (1 << number) != 0)
    latched = rows["fault"][rows["fault"] != NO_FAULT]
    for number in np.unique(latched):
        kind = KINDS[int(number)]
        add("", kind.name.lower().replace("_", " "), kind.code, rows["fault"] == number)
    return sorted(found, key=lambda met: met.first_s)
