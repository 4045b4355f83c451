"""What a run comes to: the limits that it meets, and the range of its error over the models that may be true.

Some laws decide: the observer of the tooth is given up or not (W-216), the PID falls back (W-215), the cell stops.
Near such a decision two models that differ by a hair leave two errors that have nothing to do with each other, and the
spread of those on one side says nothing of the other. So models are sorted by what happens with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from micromanip.faults import KINDS, FaultKind
from micromanip.rt.states import FALLBACK, NO_FAULT, OUTRUN, TOOTH_LOST

from .window import Window

Array = NDArray[np.float64]
Bits = NDArray[np.int64]

_QUANTILE, _WIDER = 2.045, 2.0
"""Of Student's distribution with 29 degrees of freedom, for 95 %; and by how much the interval is wider, since the
drawn models share what no drawing changes, such as their order (docs/decisions/0031, where it was measured)."""
_LEAST = np.array([[0.005], [0.015], [0.02]])
"""Share of rms, p99 and peak to which nothing is known: what the plays and the fitted actuator leave out."""
_GAPS = 2.5
"""By how much less is known where cycles are missing among the rows that count."""
_OTHERWISE = 0.1
"""Share by which the range goes beyond the few models with which something else happens."""
_FEW = 5
_NEARLY = 1.0 - 1e-9
"""A step of so much of the slew limit is at the limit."""
DECIDED = (1 << TOOTH_LOST) | (1 << FALLBACK)
"""Conditions that change what acts for good."""


class LimitMet(NamedTuple):
    """A limit that was met: its name and value, for how many cycles, and when first from the recording's beginning."""

    axis: str
    limit: str
    value: str
    cycles: int
    first_s: float


class Undecided(NamedTuple):
    """What happens with some of the models only: with how many of how many; `expected`: by the models as they are."""

    axis: str
    what: str
    code: str
    models: int
    of: int
    expected: bool


@dataclass(frozen=True)
class Outcome:
    """One run: rms, p99 and peak (3, axes), NaN where none counts; the `conditions` of each axis (axes,), as bits, of
    all rows and of those that `counted`; whether the cell stopped.
    """

    um: Array
    conditions: Bits
    counted: Bits
    stopped: bool

    def happens(self) -> Bits:
        """What decides about the errors (axes,): two runs with the same are comparable."""
        return (self.conditions & DECIDED) | (1 if self.stopped else 0)


def ranges(nominal: Outcome, drawn: list[Outcome], others: list[Outcome], *, gaps: bool = False) -> tuple[Array, Array]:
    """Low and high end (3, axes) of the errors (um).

    By the spread of those `drawn` with which the same happens as with the models as they are; and as far as any go with
    which something else does, of the `others` as well, which are drawn more widely. The high end is infinite where the
    calm gains act for want of a set-point fast enough: the swings that they leave depend on every detail.
    """
    low, high = nominal.um.copy(), nominal.um.copy()
    every = [nominal, *drawn, *others]
    all_um = np.array([each.um for each in every])
    for i in range(nominal.um.shape[1]):
        mine, least = nominal.um[:, i], _LEAST[:, 0] * (_GAPS if gaps else 1.0)
        same = [each.um[:, i] for each in drawn if each.happens()[i] == nominal.happens()[i]]
        same = [um for um in same if np.isfinite(um).all()]
        half = np.zeros(3)
        if same:
            half = _WIDER * _QUANTILE * np.sqrt(np.mean((np.array(same) - mine) ** 2, axis=0))
        changes = bool(np.any(all_um[:, :, i] != mine))
        if changes:
            half = np.maximum(half, (least if len(same) >= _FEW else np.maximum(least, _OTHERWISE)) * mine)
        finite = all_um[np.isfinite(all_um[:, :, i]).all(axis=1), :, i]
        # a half that is longer than what it is from says how far up, not how far down
        smallest = finite.min(axis=0) if len(finite) else mine
        low[:, i] = np.where(half < mine, mine - half, 0.5 * smallest)
        high[:, i] = mine + half
        for each in every:
            um = each.um[:, i]
            if each.happens()[i] != nominal.happens()[i] and np.isfinite(um).all():
                low[:, i] = np.fmin(low[:, i], (1.0 - _OTHERWISE) * um)
                high[:, i] = np.fmax(high[:, i], (1.0 + _OTHERWISE) * um)
        if changes and any(each.counted[i] & (1 << OUTRUN) for each in every):
            high[:, i] = np.inf
    return low, high


def undecided(axes: list[str], every: list[Outcome]) -> list[Undecided]:
    """What happens in some of the runs but not in all; the first is of the models as they are."""
    found = []
    for i, axis in enumerate(axes):
        for number, kind in KINDS.items():
            with_it = [bool(each.conditions[i] & (1 << number)) for each in every]
            if any(with_it) and not all(with_it):
                found.append(Undecided(axis, _name(kind), kind.code, sum(with_it), len(every), with_it[0]))
    return found


def limits_met(window: Window, parameters: NDArray[Any], rows: NDArray[Any], begin: int) -> list[LimitMet]:
    """The limits of `parameters` (1,) that `rows` (n,), of the window from row `begin` on, meet; by the time."""
    found: list[LimitMet] = []
    per_ms = 1e6 / window.period_ns

    def add(axis: str, limit: str, value: str, met: NDArray[np.bool_]) -> None:
        if met.any():
            found.append(LimitMet(axis, limit, value, int(met.sum()), window.at_s(begin + int(np.argmax(met)))))

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
            add(axis, _name(kind), kind.code, row["conditions"] & (1 << number) != 0)
    latched = rows["fault"][rows["fault"] != NO_FAULT]
    for number in np.unique(latched):
        kind = KINDS[int(number)]
        add("", _name(kind), kind.code, rows["fault"] == number)
    return sorted(found, key=lambda met: met.first_s)


def _name(kind: FaultKind) -> str:
    return kind.name.lower().replace("_", " ")
