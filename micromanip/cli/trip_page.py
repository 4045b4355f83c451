"""The page of a trip: what happened, errors, voltages with their range, and the sensors of the axis that tripped."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from micromanip.design.report.model import Curve, Plot, Section, Table
from micromanip.host.trips.evidence import error_um, milliseconds, parameters_of
from micromanip.host.trips.report import lines
from micromanip.host.trips.store import TripRecord

_SENSORS = (("gauge", "strain_um", "setpoint_um", 1), ("stage sensor", "stage_um", "reference_um", 2))
"""What each says and should say, and the bit of its fresh samples."""
_SHORTLY_MS = 5.0
_TIME = "time from the trip, ms"


def trip_sections(box: TripRecord, told: dict[str, Any]) -> Iterator[Section]:
    """What happened as a table, and the plots of the record; `told` is its story."""
    rows = [(f"{moment['ms']:.1f}", moment["axis"] or "", moment["text"]) for moment in told["timeline"]]
    table = Table("What happened, in ms from the trip", ("ms", "axis", "what"), rows)
    facts = {"likely": "; or ".join(told["likely_causes"]), "next": told["next_step"]}
    known = {name: text for name, text in facts.items() if text}
    plots = tuple(_plots(box)) if len(box.rows) else ()
    yield Section(told["seen"], told["utc"], known, plots, (table,), "\n".join(lines(told)))


def _plots(box: TripRecord) -> Iterator[Plot]:
    ms, names, rows = milliseconds(box), box.meta["axes"], box.rows["axis"]
    errors = np.array([error_um(box, i) for i in range(len(names))])
    # what the ramp leaves behind may run out of the plot
    most_um = 1.2 * float(np.nanmax(np.abs(errors[:, ms <= _SHORTLY_MS]), initial=0.0))
    if most_um > 0.0:
        errors[np.abs(errors) > most_um] = np.nan
    curves = [Curve(name, ms, error) for name, error in zip(names, errors, strict=True)]
    yield Plot("Error", _TIME, "error, um", (*curves, _trip(-most_um, most_um)))
    limiters = [parameters_of(box, i)["limiter"] for i in range(len(names))]
    ends = sorted({float(each[end]) for each in limiters for end in ("low_V", "high_V")})
    curves = [Curve(name, ms, rows["voltage_V"][:, i]) for i, name in enumerate(names)]
    curves += [Curve(f"{each:g} V", ms[[0, -1]], np.full(2, each), faint=True) for each in ends]
    yield Plot("Voltage and the ends of its range", _TIME, "voltage, V", (*curves, _trip(ends[0], ends[-1])))
    tripped = rows[:, names.index(box.trip["axis"])] if box.trip["axis"] in names else rows[:, :0]
    for sensor, said, wanted, bit in _SENSORS if tripped.size else ():
        fresh = tripped["fresh"] & bit != 0
        if fresh.any():
            curves = [Curve(f"{sensor}, fresh samples", ms[fresh], tripped[said][fresh])]
            curves.append(Curve(wanted.removesuffix("_um").replace("setpoint", "set-point"), ms, tripped[wanted]))
            yield Plot(f"Axis {box.trip['axis']}: {sensor}", _TIME, "um", tuple(curves))


def _trip(low: float, high: float) -> Curve:
    return Curve("trip", np.zeros(2), np.array([low, high]), faint=True)
