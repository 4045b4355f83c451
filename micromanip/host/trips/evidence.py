"""What the cycles of a trip show beside the faults themselves: missing samples, ends of the range, growing errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.recordings.spikes import runs
from micromanip.rt.states import HOLDING, STAGE, STRAIN, TRACKING

from .store import TripRecord

_SENSORS = (("strain", 1, "strain gauge"), ("stage", 2, "capacitive sensor"), ("deviation", 4, "reference signal"))
_LINES = (
    ("enable went off", "enable came on"),
    ("interlock went off", "interlock came on"),
    ("tool back in the cut", "tool retracted"),
    ("amplifier switched off", "amplifier switched on"),
    ("feed-hold taken back", "feed-hold asked of the machine"),
)
"""Off and on, in the order of the bits of a row's ``lines``."""
_GAP_OF_USUAL, _LEAST_GAP = 3, 3
"""A pause between two samples is told when it is that many times the usual one, and at least so many cycles."""
_FROZEN_SAMPLES = 20
_SATURATED_MS, _BRIDGED_MS = 1.0, 1.0
"""Ends of the range count when they last so long; shorter interruptions are bridged."""
_GROWN = 1.5
_BASE_ENDS_MS = -200.0
_KEPT = 3


@dataclass(frozen=True)
class Moment:
    """Something that began `ms` after the trip (negative: before), on an axis or (None) in the whole cell."""

    ms: float
    axis: str | None
    text: str


def milliseconds(box: TripRecord) -> NDArray[np.float64]:
    """Time (ms) of each row from the trip."""
    passed: NDArray[np.float64] = (box.rows["cycle"] - box.trip["cycle"]) * (box.meta["period_ns"] * 1e-6)
    return passed


def parameters_of(box: TripRecord, axis: int) -> Any:
    """The axis' parameters that were in force at the trip (the last ones where that is not known)."""
    at = int(np.searchsorted(box.rows["cycle"], box.trip["cycle"]))
    version = box.rows["version"][min(at, len(box.rows) - 1)] if len(box.rows) else -1
    chosen = np.flatnonzero(box.parameters["version"] == version)
    return box.parameters[chosen[0] if len(chosen) else -1]["axis"][axis]


def error_um(box: TripRecord, axis: int) -> NDArray[np.float64]:
    """How far (um) the axis was from where it should be, each row and as measured: stage, or gauge in mode strain.

    It is the error that the loop acted on and watched (``rt/errors.py``), which not every row holds: a sample
    less what was wanted when it was taken, a gauge's less the set-point whose voltage had arrived by then.
    """
    rows, cycles, p = box.rows["axis"][:, axis], box.rows["cycle"], parameters_of(box, axis)
    if p["mode"] == STAGE:
        wanted, sensor, late, share = "reference_um", "stage", 0, 0.0
    elif p["mode"] == STRAIN:
        wanted, sensor = "setpoint_um", "strain"
        late = int(p["answer_cycles"]) + int(p["awaited_cycles"])
        share = float(p["awaited_cycles"]) % 1.0
    else:
        return np.full(len(rows), np.nan)
    age_cycles = np.floor(rows[f"{sensor}_age_ns"] / box.meta["period_ns"] + 0.5)
    at, before = (
        rows[wanted][np.maximum(np.searchsorted(cycles, cycles - age_cycles - each, side="right") - 1, 0)]
        for each in (late, late + 1)
    )
    error: NDArray[np.float64] = at + share * (before - at) - rows[f"{sensor}_um"]
    return error


def at_end_of_range(box: TripRecord, axis: int) -> NDArray[np.bool_]:
    """Whether the voltage is at an end of its range, each row; it rests there where that is its park voltage."""
    limiter, voltage = parameters_of(box, axis)["limiter"], box.rows["axis"]["voltage_V"][:, axis]
    rests = (voltage == limiter["park_V"]) & ~np.isin(box.rows["state"], (TRACKING, HOLDING))
    at_end: NDArray[np.bool_] = ((voltage >= limiter["high_V"]) | (voltage <= limiter["low_V"])) & ~rests
    return at_end


def observations(box: TripRecord) -> list[Moment]:
    """All moments, in the order of time; of each kind those that are nearest to the trip."""
    if not len(box.rows):
        return []
    found = [*_newest(_missed_deadlines(box)), *_switched(box)]
    for i, name in enumerate(box.meta["axes"]):
        for role, bit, words in _SENSORS:
            if parameters_of(box, i)[role] >= 0:
                found += _newest(_pauses(box, i, name, bit, words))
        found += _newest(_frozen(box, i, name))
        found += _newest(_saturations(box, i, name))
        found += _grown_error(box, i, name)
    return sorted(found, key=lambda moment: moment.ms)


def _newest(moments: Iterator[Moment]) -> list[Moment]:
    return sorted(moments, key=lambda moment: abs(moment.ms))[:_KEPT]


def _missed_deadlines(box: TripRecord) -> Iterator[Moment]:
    ms, periods = milliseconds(box), box.rows["periods"]
    for k in np.flatnonzero(periods > 1):
        missed = int(periods[k]) - 1
        yield Moment(float(ms[k]), None, f"{missed} deadline{'s' if missed > 1 else ''} missed")


def _switched(box: TripRecord) -> Iterator[Moment]:
    """Digital lines that changed."""
    ms, lines = milliseconds(box), box.rows["lines"]
    for bit, words in enumerate(_LINES):
        level = (lines >> bit) & 1
        for k in np.flatnonzero(np.diff(level)) + 1:
            yield Moment(float(ms[k]), None, words[level[k]])


def _pauses(box: TripRecord, axis: int, name: str, bit: int, words: str) -> Iterator[Moment]:
    """Times without a good sample, much longer than usual on this channel."""
    cycles, ms = box.rows["cycle"], milliseconds(box)
    fresh = np.flatnonzero(box.rows["axis"]["fresh"][:, axis] & bit)
    if len(fresh) < 2:
        return
    usual = float(np.median(np.diff(fresh)))
    ends = np.append(fresh[1:], len(cycles) - 1)
    for first, last in zip(fresh.tolist(), ends.tolist(), strict=True):
        if last - first > max(_GAP_OF_USUAL * usual, _LEAST_GAP):
            begin = float(ms[min(first + round(usual), len(ms) - 1)])
            lasting = "any more" if last == ends[-1] else f"for {ms[last] - begin:.1f} ms"
            yield Moment(begin, name, f"{words}: no good sample {lasting}")


def _frozen(box: TripRecord, axis: int, name: str) -> Iterator[Moment]:
    rows = box.rows["axis"][:, axis]
    fresh = np.flatnonzero(rows["fresh"] & 1)
    for first, last in runs(np.diff(rows["strain_um"][fresh]) == 0.0):
        if last - first >= _FROZEN_SAMPLES:
            begin = float(milliseconds(box)[fresh[first]])
            yield Moment(begin, name, f"strain gauge: the same reading {last - first + 1} times in a row")


def _saturations(box: TripRecord, axis: int, name: str) -> Iterator[Moment]:
    ms = milliseconds(box)
    stretches: list[list[int]] = []
    for first, last in runs(at_end_of_range(box, axis)):
        if stretches and ms[first] - ms[stretches[-1][1] - 1] <= _BRIDGED_MS:
            stretches[-1][1] = last
        else:
            stretches.append([first, last])
    for first, last in stretches:
        lasting = float(ms[last - 1] - ms[first])
        if lasting >= _SATURATED_MS:
            volts = box.rows["axis"]["voltage_V"][first, axis]
            yield Moment(float(ms[first]), name, f"voltage at the end of its range, {volts:g} V, for {lasting:.1f} ms")


def _grown_error(box: TripRecord, axis: int, name: str) -> list[Moment]:
    """Where the error left what had been usual, and did not come back before the trip."""
    ms, error = milliseconds(box), np.abs(error_um(box, axis))
    tracking = box.rows["state"] == TRACKING
    base = error[tracking & (ms < _BASE_ENDS_MS)]
    before = (ms >= _BASE_ENDS_MS) & (ms <= 0.0)
    if not len(base) or not np.isfinite(base).all() or not before.any():
        return []
    usual = float(base.max())
    above = list(runs(before & (error > _GROWN * usual)))
    if not above:
        return []
    first, last = above[-1]
    worst = float(error[first:last].max())
    return [Moment(float(ms[first]), name, f"error above what was usual ({usual:.2f} um), up to {worst:.2f} um")]
