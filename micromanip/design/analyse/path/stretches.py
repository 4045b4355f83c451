"""Stretches of a path that ask for more than an axis has: what is asked, what there is, and by how much it is over."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.model import Output

from .prediction import Predicted

Array = NDArray[np.float64]

TRACKER, RANGE, RESERVE = "tracker range", "set-point range", "set-point reserve"
SLEW, VOLTAGE, VOLTAGE_RESERVE = "set-point slew", "voltage range", "voltage reserve"
VOLTAGE_SLEW, ERROR = "voltage slew", "following error"
_RESERVES, _RANGES = (RESERVE, VOLTAGE_RESERVE), (TRACKER, RANGE, VOLTAGE)
_JOINED_S = 0.25
"""Stretches that are nearer to one another are one: a robot's joints swing some 8 times a second."""
_LEAD_S = 0.05
"""A reserve that is used for less than this before a range ends tells nothing new."""


@dataclass(frozen=True)
class Stretch:
    """From `from_s` to `to_s` `axis` is asked for more than `limit`, at worst for `asked`, `over` it, in `unit`."""

    axis: str
    what: str
    from_s: float
    to_s: float
    asked: float
    limit: float
    over: float
    unit: str

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)


@dataclass(frozen=True)
class Demand:
    """What is asked (n,) of something that goes from `low` to `high`."""

    what: str
    unit: str
    asked: Array
    low: float
    high: float


def demands(
    axis: Axis,
    output: Output,
    seen_um: tuple[float, float],
    found: Predicted,
    reserve_um: float,
    tolerance_um: float,
) -> Iterator[Demand]:
    """All that has a limit; errors are tolerated up to `tolerance_um`, the tracker is believed within `seen_um`.

    `reserve_um` is kept at either end of the set-point's range, and the same share of it of the voltage's.
    """
    per_ms = 1e-3 * found.rate_Hz
    low, high = axis.setpoint.range_um
    slew = axis.setpoint.slew_um_per_ms
    yield Demand(TRACKER, "um", found.deviation_um, *seen_um)
    yield Demand(RANGE, "um", found.setpoint_um, low, high)
    yield Demand(RESERVE, "um", found.setpoint_um, low + reserve_um, high - reserve_um)
    yield Demand(SLEW, "um/ms", _steps(found.setpoint_um) * per_ms, -slew, slew)
    if found.voltage_V is not None:
        low_V, high_V = output.range_V
        reserve_V = reserve_um * (high_V - low_V) / (high - low)
        yield Demand(VOLTAGE, "V", found.voltage_V, low_V, high_V)
        yield Demand(VOLTAGE_RESERVE, "V", found.voltage_V, low_V + reserve_V, high_V - reserve_V)
        steps = _steps(found.voltage_V) * per_ms
        yield Demand(VOLTAGE_SLEW, "V/ms", steps, -output.slew_V_per_ms, output.slew_V_per_ms)
    yield Demand(ERROR, "um", found.error_um, -tolerance_um, tolerance_um)


def stretches(axis: str, demand: Demand, rate_hz: float) -> list[Stretch]:
    """Where `demand` is over its limit, in order of time."""
    over = np.maximum(demand.asked - demand.high, demand.low - demand.asked)
    outside = np.flatnonzero(over > 0.0)
    if not len(outside):
        return []
    pieces = np.split(outside, np.flatnonzero(np.diff(outside) > _JOINED_S * rate_hz) + 1)
    found = []
    for piece in pieces:
        worst = int(piece[np.argmax(over[piece])])
        asked = float(demand.asked[worst])
        limit = demand.high if asked > demand.high else demand.low
        found.append(
            Stretch(
                axis, demand.what, float(piece[0] / rate_hz), float((piece[-1] + 1) / rate_hz), asked, limit,
                float(over[worst]), demand.unit,
            )
        )  # fmt: skip
    return found


def beyond(found: list[Stretch]) -> list[Stretch]:
    """Without the stretches of a reserve around one that is beyond a range itself, unless they begin well before it."""
    hard = [each for each in found if each.what in _RANGES]
    return [
        stretch
        for stretch in found
        if stretch.what not in _RESERVES
        or not any(each.from_s - _LEAD_S <= stretch.from_s <= each.to_s for each in hard)
    ]


def _steps(values: Array) -> Array:
    return np.asarray(np.diff(values, prepend=values[:1]))
