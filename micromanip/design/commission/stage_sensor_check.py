"""The stage sensor over the first travel through the range, and the answer to a small step: all in open loop.

What makes an outer loop dangerous or useless is seen here, before even the strain loop is closed: a sensor that stands
still, is clipped or sees another axis, a wrong unit or sign, lost motion in the flexure, an amplifier slower than the
path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend

from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.recordings import TimeSeries
from micromanip.settings.schema.model import Configuration

from ..excitation import half_cosine
from ..experiment import Experiment, open_loop, parked, play

_LEAST_SLOPE, _MOST_SLOPE = 0.05, 50.0
"""Stage over gauge: no lever is outside."""
_NEAR, _FOLLOWS, _HELD, _LOST_MOTION = 0.15, 0.5, 0.2, 0.05
"""Share of the set-point's range about the working point. There: correlation of stage and gauge; share of the samples
without a new reading; how far the stage may stay behind where the actuator turns, as a share of its travel there."""
_OFF_CENTRE = 0.5
"""How far the stage's zero may be from the working point, as a share of the way to the nearer end of the range."""
_OTHER = 5.0
STEP_V, _RISE_S, BEFORE_S, _AFTER_S, _LIFT_S = 5.0, 0.002, 0.1, 0.5, 0.5
_LATE_S, _SETTLED_S, _PADDED, _TURNS = 0.2, 0.02, 8, 2
_FAR, _LONGER, _RISEN = 6.0, 1.5, float(1.0 - np.exp(-1.0))
"""A step so many times as large takes at most so many times as long, or the slew rate limits it; a rise's share."""
_SWING_SHARE, _SWINGS_PER_PATH = 0.1, 2.0
"""A swing of the stage counts from this share of its step; it must be so many times faster than the path."""


def check_travel(configuration: Configuration, axis: str, record: TimeSeries, others_um: dict[str, float]) -> Travel:
    """The stage near the working point, from a `record` in open loop; `others_um`: travel of the other stages.

    Raises CheckFailed where the sensor, its scale or the flexure is no good for an outer loop.
    """
    settings = configuration.axes[axis]
    stage = record["stage_um"] if "stage_um" in record.names else np.full(len(record), np.nan)
    low, high = settings.setpoint.range_um
    near = np.abs(record.y - settings.centre_um) < _NEAR * (high - low)
    strain, stage, volts = (column[near] for column in (record.y, stage, record.u))
    moved_um, good, where = float(np.ptp(strain)), np.isfinite(stage), f"signals.stage_{axis}"
    own_um = float(np.ptp(stage[good])) if good.any() else 0.0
    other = max(others_um, key=lambda name: others_um[name], default=axis)
    if others_um.get(other, 0.0) > max(_OTHER * own_um, moved_um):
        raise CheckFailed(
            f"axis {axis}: while its actuator moved by {moved_um:.0f} um its stage sensor saw {own_um:.2g} um, but "
            f"that of axis {other} {others_um[other]:.0f} um: the stage sensors or the outputs are swapped; check "
            "cables and the channels in the sections signals and outputs. No loop was closed"
        )
    if not good.any():
        raise CheckFailed(
            f"axis {axis}: the stage sensor gave no usable sample while the actuator moved by {moved_um:.0f} um "
            "about the working point: none come, or they are late, no numbers, flagged as invalid, or outside "
            f"range_um of {where}; `micromanip device probe CONFIG` shows what it says. No loop was closed"
        )
    if own_um == 0.0:
        raise CheckFailed(
            f"axis {axis}: the stage sensor reads exactly {stage[good][0]:g} um while the actuator moves by "
            f"{moved_um:.0f} um: it is dead, not connected or on its rail; check its supply, cable and zero, and "
            f"{where}. No loop was closed"
        )
    missing = 1.0 - float(good.mean()) + float(np.mean(np.diff(stage[good]) == 0.0))
    if missing > _HELD:
        raise CheckFailed(
            f"axis {axis}: about the working point, {settings.centre_um:g} um of the gauge, the stage sensor is at "
            f"an end of its range or gives no usable sample {100 * missing:.0f} % of the time: shift its zero or its "
            f"range, or centre_um. {100 * _HELD:.0f} % would do. No loop was closed"
        )
    strain, stage, volts = strain[good], stage[good], volts[good]
    correlation = abs(float(np.corrcoef(strain, stage)[0, 1]))
    if correlation < _FOLLOWS:
        raise CheckFailed(
            f"axis {axis}: the stage sensor does not follow the actuator: while the gauge moved by {moved_um:.0f} um "
            f"it read {stage.std():.2g} um rms of something else (correlation {correlation:.2f}, {_FOLLOWS:g} would "
            "do); check that it is the sensor of this axis, and that target and flexure are fixed. No loop was closed"
        )
    slope = float(np.polyfit(strain, stage, 1)[0])
    if not _LEAST_SLOPE <= abs(slope) <= _MOST_SLOPE:
        raise CheckFailed(
            f"axis {axis}: the stage sensor moves by {slope:.2g} um for 1 um of the gauge; a lever makes "
            f"{_LEAST_SLOPE:g} to {_MOST_SLOPE:g} of it: check scale and unit (mm for um?) of {where}. "
            "No loop was closed"
        )
    if slope < 0.0:
        raise CheckFailed(
            f"axis {axis}: the stage sensor falls by {-slope:.2g} um for each um that the gauge rises: the path "
            "would be corrected the wrong way; change the sign of its scale, so that all of an axis counts in one "
            "direction. No loop was closed"
        )
    lost_um = _lost_motion(strain, stage, volts)
    if lost_um > _LOST_MOTION * float(np.ptp(stage)):
        raise CheckFailed(
            f"axis {axis}: where the actuator turns the stage stays {lost_um:.2g} um behind, "
            f"{100 * lost_um / np.ptp(stage):.0f} % of its travel of {np.ptp(stage):.0f} um, {100 * _LOST_MOTION:g} % "
            "would do: a loose flexure, clamp or sensor target; tighten it. No loop was closed"
        )
    return Travel(slope, float(np.polyval(np.polyfit(strain - settings.centre_um, stage, 1), 0.0)))


@dataclass(frozen=True)
class Travel:
    """Near the working point: um of the stage for one of the gauge, and what the stage reads (um) at `centre_um`."""

    slope: float
    at_centre_um: float


def require_centred(configuration: Configuration, axis: str, travel: Travel) -> None:
    """The path begins at the stage's zero. Raises CheckFailed where that is far from the working point.

    For a stage whose flexure is known to hold: a loose one leans anywhere.
    """
    settings = configuration.axes[axis]
    low, high = settings.setpoint.range_um
    off_um = abs(travel.at_centre_um / travel.slope)
    most_um = _OFF_CENTRE * min(settings.centre_um - low, high - settings.centre_um)
    if off_um > most_um:
        raise CheckFailed(
            f"axis {axis}: the stage sensor reads {travel.at_centre_um:.1f} um where the gauge reads centre_um, "
            f"{settings.centre_um:g} um, and should read 0: the path begins at its zero, {off_um:.0f} um of the "
            f"gauge away, at most {most_um:.0f}, and would press against an end of setpoint.range_um; shift its "
            f"zero by {travel.at_centre_um:.1f} um, or move centre_um. No loop was closed"
        )


def _lost_motion(strain: Array, stage: Array, volts: Array) -> float:
    """By how much (um) the stage differs between both ways at the same reading of the gauge."""
    rising = np.gradient(volts) > 0.0
    if not 0.1 < rising.mean() < 0.9:
        return 0.0
    regressors = np.column_stack([np.ones(len(strain)), strain, np.where(rising, -0.5, 0.5)])
    return max(0.0, float(np.linalg.lstsq(regressors, stage, rcond=None)[0][2]))


@dataclass(frozen=True)
class Answer:
    """What a small step shows: until the gauge has made 63 % of its way, and the stage's swing afterwards, if any.

    `stage_before_um`: the stage sensor (n,) in the BEFORE_S before it, without drift.
    """

    rise_ms: float
    swing_Hz: float | None
    stage_before_um: Array

    def slow(self, path_Hz: float) -> str:
        """What is to be said of a gauge that answers slower than the path goes; empty where it does not."""
        if 1e-3 * self.rise_ms <= 1.0 / (2.0 * np.pi * path_Hz):
            return ""
        return (
            f"; after a step of {STEP_V:g} V the gauge needs {self.rise_ms:.0f} ms for 63 % of its way, too slow for "
            f"the {path_Hz:g} Hz of accept.frequencies_Hz: an amplifier with too little current or bandwidth, or a "
            "filter"
        )


def check_answer(configuration: Configuration, experiment: Experiment, axis: str, centre_V: float) -> Answer:
    """Step `axis` by STEP_V about `centre_V` in open loop, and farther.

    Raises CheckFailed where the stage swings too slowly, or the amplifier is slower than its slew limit says.
    """
    rate_hz, path_Hz = configuration.loop.rate_hz, max(configuration.axes[axis].accept.frequencies_Hz)
    answer = judge_answer(*_step(configuration, experiment, axis, centre_V, STEP_V), rate_hz)
    if answer.swing_Hz is not None and answer.swing_Hz < _SWINGS_PER_PATH * path_Hz:
        raise CheckFailed(
            f"axis {axis}: after a step of {STEP_V:g} V the stage swings at {answer.swing_Hz:.0f} Hz, and the path "
            f"goes up to {path_Hz:g} Hz, so {_SWINGS_PER_PATH * path_Hz:g} Hz are needed: a loose flexure or clamp, or "
            "more mass than it is made for; look at it, or accept lower frequencies. No loop was closed"
        )
    output, strain_cycles = configuration.outputs[f"voltage_{axis}"], experiment.path(configuration, axis).strain_cycles
    far_V = min(_FAR * STEP_V, *(1.8 * abs(end_V - centre_V) for end_V in output.range_V))
    if far_V <= STEP_V:
        return answer
    far_ms = judge_answer(*_step(configuration, experiment, axis, centre_V, far_V), rate_hz).rise_ms
    if far_ms > _LONGER * answer.rise_ms + 2e3 * strain_cycles / rate_hz:
        gives = _RISEN * far_V / far_ms
        raise CheckFailed(
            f"axis {axis}: a step of {STEP_V:g} V takes the gauge {answer.rise_ms:.1f} ms for 63 % of its way, one of "
            f"{far_V:.0f} V {far_ms:.0f} ms: the amplifier gives {gives:.2g} V/ms, and outputs.voltage_{axis} says "
            f"{output.slew_V_per_ms:g}. Mend it, or set slew_V_per_ms: {gives:.2g}. No loop was closed"
        )
    return answer


def _step(
    configuration: Configuration, experiment: Experiment, axis: str, centre_V: float, step_V: float
) -> tuple[NDArray[Any], int]:
    """Rows of `axis` around a step, which begins after so many of them."""
    rate_hz, index = configuration.loop.rate_hz, list(configuration.axes).index(axis)
    output = configuration.outputs[f"voltage_{axis}"]
    parts = (_LIFT_S, BEFORE_S, max(_RISE_S, 4e-3 * _FAR * STEP_V / output.slew_V_per_ms), _AFTER_S, _LIFT_S)
    lift, before, rise, after, _ = (round(seconds * rate_hz) for seconds in parts)
    way = np.concatenate([half_cosine(lift), np.ones(before + rise + after), 1.0 - half_cosine(lift)])
    step = np.concatenate([np.zeros(lift + before), half_cosine(rise), np.ones(after), 1.0 - half_cosine(lift)])
    samples = parked(configuration, len(way))
    samples[:, index] += (centre_V - output.park_V) * way + step_V * (step - 0.5 * way)
    return play(open_loop(configuration), experiment, samples)[lift : lift + before + rise + after, index], before


def judge_answer(rows: NDArray[Any], before: int, rate_hz: float) -> Answer:
    """From rows of one axis around a step that begins after `before` of them."""
    strain, stage = (np.asarray(rows[name], dtype=float) for name in ("strain_um", "stage_um"))
    late = round(_LATE_S * rate_hz)
    rest, way = strain[:before].mean(), strain[-late:].mean() - strain[:before].mean()
    rise_ms = 1e3 * int(np.argmax((strain[before:] - rest) / way >= _RISEN)) / rate_hz
    after = stage[before + round(_SETTLED_S * rate_hz) :]
    swing, stage_before = (
        (detrend(after), detrend(stage[:before])) if np.isfinite(stage).all() else (np.zeros(len(after)), np.zeros(1))
    )
    if np.ptp(swing) <= _SWING_SHARE * abs(stage[-late:].mean() - stage[:before].mean()):
        return Answer(rise_ms, None, stage_before)
    count = _PADDED * len(swing)
    spectrum = np.abs(np.fft.rfft(swing * np.hanning(len(swing)), count))
    slowest = round(_TURNS * count / len(swing))
    k = int(np.argmax(spectrum[slowest:]))  # at the lowest it is a slow answer, not a swing
    return Answer(rise_ms, float((slowest + k) * rate_hz / count) if k > 0 else None, stage_before)
