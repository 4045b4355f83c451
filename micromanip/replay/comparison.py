"""Where a replayed row is another than the recorded one, bit for bit, in the order in which the cycle computes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_SENSORS = ("fresh", "strain_um", "stage_um", "deviation_um", "strain_age_ns", "stage_age_ns", "deviation_age_ns")
_CELL = ("cycle", "state", "phase", "fault", "version", "lines")
_LAW = (
    "reference_um", "estimate_um", "innovation_um", "setpoint_um", "feedforward_V", "notch_um", "feedback_V",
    "voltage_V", "path_error_um", "uncompensated_um", "conditions",
)  # fmt: skip


class Value(NamedTuple):
    """A number of one row as it was recorded and as it came again; `axis` is empty where it is the cell's."""

    name: str
    axis: str
    recorded: float
    replayed: float


@dataclass(frozen=True)
class Mismatch:
    """Row `at` of a part is the first that differs, in `values`: what the cycle computes first comes first."""

    at: int
    values: list[Value]


def first_mismatch(recorded: NDArray[Any], replayed: NDArray[Any], axes: list[str]) -> Mismatch | None:
    """The first of the rows (n,) that are not the same; None where all are."""
    differs = np.zeros(len(recorded), bool)
    columns = [(name, "", *_pair(recorded, replayed, name)) for name in _CELL[:1]]
    for names in (_SENSORS, _LAW):
        for k, axis in enumerate(axes):
            one, two = recorded["axis"][:, k], replayed["axis"][:, k]
            columns += [(name, axis, *_pair(one, two, name)) for name in names]
        if names is _SENSORS:
            columns += [(name, "", *_pair(recorded, replayed, name)) for name in _CELL[1:]]
    for _, _, one, two in columns:
        differs |= _unequal(one, two)
    if not differs.any():
        return None
    at = int(np.argmax(differs))
    found = [
        Value(name, axis, one[at].item(), two[at].item())
        for name, axis, one, two in columns
        if _unequal(one[at : at + 1], two[at : at + 1])[0]
    ]
    return Mismatch(at, found)


def _pair(one: NDArray[Any], two: NDArray[Any], name: str) -> tuple[NDArray[Any], NDArray[Any]]:
    return np.ascontiguousarray(one[name]), np.ascontiguousarray(two[name])


def _unequal(one: NDArray[Any], two: NDArray[Any]) -> NDArray[np.bool_]:
    """By the bits; no number is as good as no number."""
    if one.dtype.kind != "f":
        return np.asarray(one != two)
    return np.asarray((one.view(np.int64) != two.view(np.int64)) & ~(np.isnan(one) & np.isnan(two)))
