"""From the sections ``faults`` to what the loop compares with: times become cycles, ``null`` what is never reached."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from micromanip.rt import states
from micromanip.rt.states import REACTION_NAMES
from micromanip.settings.schema.faults import SWING_S, SWINGS, AxisFaults, Faults
from micromanip.settings.schema.reference import Reference, Tracker

NEVER = int(np.iinfo(np.int64).max // 4)
_DRIFT_MS = 300.0
"""Time over which the tooth and the path's own motion are no drift."""
_SHOWN = 0.45
"""Share of the rate up to which samples show a frequency."""
_TOOTH_Q = 4.0
"""Of the notch at the tooth's frequency: it leaves a third of what is 5 % off, the farthest that one is followed to."""


def _reach(count: int | None) -> int:
    return NEVER if count is None else count


def _limit(value: float | None) -> float:
    return math.inf if value is None else value


def fill_cell_limits(p: Any, faults: Faults, rate_hz: int) -> None:
    """Fill the cell's limits and reactions."""
    deadline = faults.deadline
    p["overruns_in_a_row"] = _reach(deadline.in_a_row)
    p["overrun_share"] = 0.0 if deadline.share_percent is None else deadline.share_percent / 100.0
    # a bucket that leaks by the share: it overflows at what the share is of one second
    p["overrun_level"] = math.inf if deadline.share_percent is None else max(1.0, p["overrun_share"] * rate_hz)
    p["heartbeat_ns"] = round(faults.host.silent_ms * 1e6)
    p["hold_cycles"] = max(1, round(faults.hold.timeout_s * rate_hz))
    for code, section in (
        (states.OVERRUNS, deadline),
        (states.HOST_DEAD, faults.host),
        (states.DRIVER_ERROR, faults.driver),
        (states.LINK_LOST, faults.link),
        (states.OUTPUTS_TAKEN, faults.link),
        (states.ENABLE_LOST, faults.enable),
        (states.INTERLOCK_OPEN, faults.interlock),
    ):
        p["reaction"][code] = REACTION_NAMES.index(section.reaction)


def fill_axis_limits(
    a: Any,
    faults: AxisFaults,
    reference: Reference,
    rate_hz: int,
    strain_rate_hz: float,
    stage_cycles: int,
    tooth_Hz: float | None,
) -> None:
    """Fill the limits and reactions of one axis, whose sensors are fresh so often and which cancels a tooth."""
    w = a["watch"]

    def cycles(ms: float | None) -> int:
        return NEVER if ms is None else max(1, round(ms * 1e-3 * rate_hz))

    for role, section in (("strain", faults.strain), ("stage", faults.stage)):
        w[f"{role}_samples"], w[f"{role}_identical"] = _reach(section.samples), _reach(section.identical)
        a[f"{role}_rate_um_per_ns"] = _limit(section.rate_um_per_ms) * 1e-6
    w["coast_cycles"] = round(faults.strain.coast_ms * 1e-3 * rate_hz)
    w["degraded_cycles"] = round(faults.stage.degraded_s * rate_hz)
    w["innovation_ratio"] = _limit(faults.disagreement.ratio)
    w["innovation_step"] = min(1.0, stage_cycles / cycles(faults.disagreement.time_ms))
    w["innovation_variance"] = 1.0
    w["drift_um"] = _limit(faults.disagreement.drift_um)
    w["drift_step"] = min(1.0, stage_cycles / cycles(_DRIFT_MS))
    w["reference_identical"] = _reach(faults.reference.identical)
    w["following_um"] = _limit(faults.following_error.limit_um)
    w["following_cycles"] = cycles(faults.following_error.time_ms)
    w["saturating_cycles"], w["saturated_cycles"] = cycles(faults.saturation.warn_ms), cycles(faults.saturation.time_ms)
    _fill_band(w, faults, rate_hz, strain_rate_hz)
    _fill_tooth_notch(w["tooth_notch"], tooth_Hz, strain_rate_hz)
    if isinstance(reference, Tracker):
        period_ms = 1e3 / reference.sample_rate_Hz
        stale = faults.reference.stale_periods
        w["stale_cycles"] = NEVER if stale is None else cycles(stale * period_ms)
    w["lost_cycles"] = cycles(faults.reference.time_ms)
    w["decay_cycles"] = cycles(faults.reference.decay_ms)
    w["derate"] = faults.over_temperature.derate_percent / 100.0
    w["swings"], w["swing_cycles"] = SWINGS, cycles(SWING_S * 1e3)
    w["hot_cycles"] = cycles(faults.over_temperature.time_s * 1e3)
    for code, reaction in (
        (states.STRAIN_INVALID, faults.strain.reaction),
        (states.STRAIN_SILENT, faults.strain.reaction),
        (states.STRAIN_STUCK, faults.strain.reaction),
        (states.STAGE_INVALID, faults.stage.reaction),
        (states.STAGE_STUCK, faults.stage.reaction),
        (states.DISAGREEMENT, faults.disagreement.reaction),
        (states.STAGE_DRIFT, faults.disagreement.reaction),
        (states.FOLLOWING_ERROR, faults.following_error.reaction),
        (states.SATURATED, faults.saturation.reaction),
        (states.OSCILLATION, faults.oscillation.reaction),
        (states.REFERENCE_LOST, faults.reference.reaction),
        (states.AMPLIFIER_FAULT, faults.amplifier.reaction),
        (states.OVER_TEMPERATURE, faults.over_temperature.reaction),
        (states.NOT_FINITE, "ramp"),
        (states.LIMIT_CYCLE, "ramp"),
        (states.STRAIN_CHECK, "ramp"),
        (states.STAGE_CHECK, "ramp"),
    ):
        w["reaction"][code] = REACTION_NAMES.index(reaction)


def _fill_band(w: Any, faults: AxisFaults, rate_hz: int, strain_rate_hz: float) -> None:
    """Filter by the bilinear transform, and its mean energy, one step per sample of the gauge.

    A band pass s w0/Q / (s^2 + s w0/Q + w0^2); where the band goes beyond what so few samples show, a high pass
    (Butterworth) at its lower end: a loop may swing from one sample to the next.
    """
    low, high = faults.oscillation.band_Hz
    middle = math.sqrt(low * high)
    passes_all = high > _SHOWN * strain_rate_hz
    omega = 2.0 * math.pi * min(low if passes_all else middle, _SHOWN * strain_rate_hz) / strain_rate_hz
    alpha = math.sin(omega) * (math.sqrt(0.5) if passes_all else (high - low) / (2.0 * middle))
    cosine = math.cos(omega)
    b = (0.5 * (1.0 + cosine), -1.0 - cosine, 0.5 * (1.0 + cosine)) if passes_all else (alpha, 0.0, -alpha)
    w["band_pass"]["b"] = np.array(b) / (1.0 + alpha)
    w["band_pass"]["a"] = -2.0 * cosine / (1.0 + alpha), (1.0 - alpha) / (1.0 + alpha)
    w["band_um"] = _limit(faults.oscillation.limit_um)
    w["band_cycles"] = max(1, round(faults.oscillation.time_ms * 1e-3 * rate_hz))
    w["band_step"] = min(1.0, 4.0 / w["band_cycles"] * rate_hz / strain_rate_hz)


def _fill_tooth_notch(section: Any, tooth_Hz: float | None, strain_rate_hz: float) -> None:
    """(s^2 + w0^2) / (s^2 + s w0/Q + w0^2) by the bilinear transform; nothing where no sample shows the tooth."""
    section["b"], section["a"] = (1.0, 0.0, 0.0), (0.0, 0.0)
    if tooth_Hz is None or tooth_Hz > _SHOWN * strain_rate_hz:
        return
    omega = 2.0 * math.pi * tooth_Hz / strain_rate_hz
    alpha, cosine = math.sin(omega) / (2.0 * _TOOTH_Q), math.cos(omega)
    section["b"] = np.array((1.0, -2.0 * cosine, 1.0)) / (1.0 + alpha)
    section["a"] = -2.0 * cosine / (1.0 + alpha), (1.0 - alpha) / (1.0 + alpha)
