"""The preview of a path on a cell: stretches beyond what each axis has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.recordings.path_deviation import PathDeviation
from micromanip.settings.check import Prepared
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.model import Output
from micromanip.settings.schema.reference import Tracker
from micromanip.settings.wiring.timing import AT_ONCE, cycles_between, feedback_path, signal_timing

from ..budget.loop import AxisLaws
from ..budget.tracking import Tracking
from .prediction import MOST_HZ, Predicted, predict
from .seen import on_grid

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


TOLERANCE_UM = 5.0
"""Following error where the file asks for none."""
_PEAK = 3.0
"""Peak over rms of an error."""


@dataclass(frozen=True)
class AxisPreview:
    """What one axis would do, and where more is asked of it than it has."""

    axis: str
    predicted: Predicted
    tolerance_um: float
    stretches: tuple[Stretch, ...]

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        found, per_ms = self.predicted, 1e-3 * self.predicted.rate_Hz
        return {
            "axis": self.axis,
            "deviation_um": _ends(found.deviation_um),
            "setpoint_um": _ends(found.setpoint_um),
            "setpoint_um_per_ms": float(np.abs(np.diff(found.setpoint_um)).max() * per_ms),
            "voltage_V": None if found.voltage_V is None else _ends(found.voltage_V),
            "error_um": {
                "rms": float(np.sqrt(np.mean(found.error_um**2))),
                "peak": float(np.abs(found.error_um).max()),
                "tolerance": self.tolerance_um,
            },
            "stretches": [asdict(stretch) for stretch in self.stretches],
        }


@dataclass(frozen=True)
class Preview:
    """All axes on one path."""

    seconds: float
    axes: tuple[AxisPreview, ...]
    notes: tuple[str, ...]

    @property
    def fits(self) -> bool:
        """Whether nothing is asked for that is not there."""
        return not any(axis.stretches for axis in self.axes)

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "fits": self.fits,
            "seconds": self.seconds,
            "axes": [axis.document() for axis in self.axes],
            "notes": list(self.notes),
        }


def laws_on_path(prepared: Prepared, axis: str) -> tuple[AxisLaws, Tracking]:
    """The laws of `axis`, and what its tracker makes of a path. Raises CheckFailed where that can't be computed."""
    configuration, tracker = prepared.configuration, prepared.configuration.reference
    if not isinstance(tracker, Tracker):
        raise CheckFailed(
            f"{prepared.source.path}: a preview is of what a tracker would see: reference.source is {tracker.source}, "
            "it must be signal"
        )
    period_s, own = configuration.loop.period_ns * 1e-9, tracker.of(axis)
    followed = tracker.frame.signals[0] if tracker.frame else f"deviation_{axis}"
    channel = signal_timing(configuration, prepared.wiring, followed)
    tracking = Tracking(own, cycles_between(configuration, channel), channel.latency_s, period_s)
    return AxisLaws(axis, configuration.axes[axis], own, period_s), tracking


def _axis_preview(
    prepared: Prepared, axis: str, deviation_um: Array, rate_hz: float, reserve_um: float, tolerance_um: float | None
) -> AxisPreview:
    """One axis on `deviation_um` (n,); `tolerance_um` None is what the file asks for."""
    configuration, (laws, tracking) = prepared.configuration, laws_on_path(prepared, axis)
    asked, output = laws.axis.accept.tracking_error_um, configuration.outputs[f"voltage_{axis}"]
    allowed_um = (TOLERANCE_UM if asked is None else _PEAK * asked) if tolerance_um is None else tolerance_um
    low, high = laws.axis.setpoint.range_um
    if 2.0 * reserve_um >= high - low:
        raise CheckFailed(f"axis {axis}: a reserve of {reserve_um:g} um leaves nothing of {low:g}..{high:g} um")
    found = predict(laws, tracking, output.park_V, deviation_um, rate_hz)
    assert isinstance(configuration.reference, Tracker)
    asking = demands(laws.axis, output, configuration.reference.range_um, found, reserve_um, allowed_um)
    over = [stretch for demand in asking for stretch in stretches(axis, demand, rate_hz)]
    return AxisPreview(axis, found, allowed_um, tuple(sorted(beyond(over), key=lambda each: each.from_s)))


def preview_of(prepared: Prepared, path: PathDeviation, reserve_um: float, tolerance_um: float | None) -> Preview:
    """The preview of `path` on its axes. CheckFailed where it can't be made."""
    configuration = prepared.configuration
    rate_hz = min(MOST_HZ, float(configuration.loop.rate_hz))
    deviation, notes = on_grid(path, rate_hz)
    axes = tuple(
        _axis_preview(prepared, axis, column, rate_hz, reserve_um, tolerance_um)
        for axis, column in zip(path.axes, deviation.T, strict=True)
    )
    late = (
        f"axis {axis} is behind a bus: predicted as if its sensors were read, and its voltage written, at once"
        for axis in path.axes
        if feedback_path(configuration, prepared.wiring, axis) != AT_ONCE
    )
    return Preview(float(path.time_s[-1]), axes, (*late, *notes))


def _ends(values: Array) -> list[float]:
    return [float(values.min()), float(values.max())]
