"""The reference of one axis: position, velocity, acceleration and oscillation at this very moment.

Own sources are a constant, a sum of sines as (25), a step, samples played cycle by cycle, and a position that is jogged
by hand. A signal (laser tracker) arrives late and at its own rate: a Kalman filter with the state
``w = [p, v, a, o1, o1', ..]`` (up to three oscillations o of known decay, their frequencies known or found,
``frequency_lock.py``) is corrected at each sample's own time and extrapolated to now in closed form (``predictor.py``),
with a narrow one beside it if configured; the law can also just hold the sample. Only finite samples inside
``[low_um, high_um]`` are used, and none that jumps by more than ``jump_um`` from its expectation; ``silent`` counts the
cycles since a used sample. A signal that stays where it jumped to is accepted after the horizon, but not while the axis
follows it (`followed`): after that time in doubt (``doubted``) it counts as silent until the watch reports it lost.

The horizon counts cycles that ran: a loop that stood still missed samples of a signal that may have continued. Its next
sample is judged by the extrapolation over that time, up to ``STOOD_STILL`` horizons.
"""

from __future__ import annotations

import math
from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record

from .frequency_lock import JOINTS, JOINTS_STATE, as_rates, follow_joints, keep_detuning
from .frequency_lock import MAX_MODES as MAX_MODES
from .predictor import (
    STATES,
    STEADY,
    STEADY_STATE,
    extrapolate,
    follow_narrowly,
    give_both,
    keep_given,
    narrow_anew,
    position,
)

HOLD, SINES, STEP, SIGNAL, SAMPLES, JOG = range(6)

MAX_SINES = 8
STOOD_STILL = 5.0
REFERENCE_STATES = STATES
REFERENCE_PARAMETERS = record(
    ("kind", "i8"),
    ("offset_um", "f8"),
    ("start_s", "f8"),
    ("step_um", "f8"),
    ("sines", "i8"),
    ("amplitude_um", "f8", (MAX_SINES,)),
    ("omega", "f8", (MAX_SINES,)),
    ("phase", "f8", (MAX_SINES,)),
    ("samples_per_s", "f8"),
    ("column", "i8"),
    ("predict", "i8"),
    ("modes", "i8"),
    ("oscillator", "f8", (MAX_MODES,)),
    ("decay", "f8", (MAX_MODES,)),
    *JOINTS,
    ("gain", "f8", (REFERENCE_STATES,)),
    *STEADY,
    ("horizon_s", "f8"),
    ("horizon_cycles", "i8"),
    ("low_um", "f8"),
    ("high_um", "f8"),
    ("jump_um", "f8"),
    ("target_um", "f8"),
    ("speed_um", "f8"),
    ("smoothing", "f8"),
)
REFERENCE_STATE = record(
    ("filtered", "f8", (REFERENCE_STATES,)),
    ("w", "f8", (REFERENCE_STATES,)),
    ("ahead", "f8", (REFERENCE_STATES,)),
    *JOINTS_STATE,
    *STEADY_STATE,
    ("time_ns", "i8"),
    ("sequence", "i8"),
    ("sampled_um", "f8"),
    ("rejected", "i8"),
    ("silent", "i8"),
    ("doubted", "i8"),
    ("jog_um", "f8"),
    ("jog_step_um", "f8"),
    ("ahead_um", "f8"),
)


@compiled.rare
def own_reference(p: Record, w: Any, t_s: float, samples: Any) -> None:
    """Fill `w` from the axis' own source, `t_s` seconds after tracking began.

    `samples` (n, axes) are um, one per cycle; the first and the last are held, at rest, before and after.
    """
    for i in range(REFERENCE_STATES):
        w[i] = 0.0
    w[0] = p["offset_um"]
    t = t_s - p["start_s"]
    if p["kind"] == SAMPLES:
        last = len(samples) - 1
        place = t * p["samples_per_s"]
        k = max(0, min(last, int(place + 0.5)))
        w[0] = samples[k, p["column"]]
        if 0.0 <= place <= last:
            before, after = samples[max(0, k - 1), p["column"]], samples[min(last, k + 1), p["column"]]
            w[1] = 0.5 * p["samples_per_s"] * (after - before)
        return
    if t < 0.0:
        return
    if p["kind"] == STEP:
        w[0] += p["step_um"]
    elif p["kind"] == SINES:
        for i in range(p["sines"]):
            omega, angle = p["omega"][i], p["omega"][i] * t + p["phase"][i]
            sine, cosine = math.sin(angle), math.cos(angle)
            w[0] += p["amplitude_um"][i] * (sine - math.sin(p["phase"][i]))
            w[1] += p["amplitude_um"][i] * omega * cosine
            w[2] -= p["amplitude_um"][i] * omega * omega * sine


@compiled
def previewed(p: Record, s: Record, t_s: float, samples: Any) -> float:
    """Position (um) of the axis' own source at the future time `t_s`; linear between two samples."""
    own_reference(p, s["ahead"], t_s, samples)
    beyond_s = 0.0
    if p["kind"] == SAMPLES:
        place = (t_s - p["start_s"]) * p["samples_per_s"]
        beyond_s = (place - math.floor(place + 0.5)) / p["samples_per_s"]
    return s["ahead"][0] + beyond_s * s["ahead"][1]


@compiled
def is_foreseen(p: Record, s: Record, gap_s: float) -> bool:
    """Whether the last sample still predicts the signal `gap_s` after it."""
    stood_still = s["silent"] <= p["horizon_cycles"] and gap_s <= STOOD_STILL * p["horizon_s"]
    return stood_still or gap_s <= p["horizon_s"]


@compiled
def signal_sample(p: Record, s: Record, value_um: float, time_ns: int, followed: bool = False) -> None:
    """Take a fresh sample of the reference signal, measured at `time_ns`; one out of order is ignored."""
    if not (math.isfinite(value_um) and p["low_um"] <= value_um <= p["high_um"]):
        s["rejected"] += 1
        return
    gap_s = (time_ns - s["time_ns"]) * 1e-9
    if s["time_ns"] != 0 and gap_s <= 0.0:
        return
    own, detuning, innovation = s["filtered"], s["detuning"], math.nan
    if p["steady"]:
        own, detuning = s["wide"], s["wide_detuning"]
    if s["time_ns"] != 0 and is_foreseen(p, s, gap_s):
        extrapolate(p, detuning, own, gap_s, s["w"])
        innovation = value_um - position(s["w"])
    # once nothing is expected any more, whoever follows it stands where it was last
    lost = followed and not math.isfinite(innovation)
    moved_um = value_um - s["sampled_um"] if lost else 0.0
    if abs(innovation if math.isfinite(innovation) else moved_um) > p["jump_um"] or (lost and s["doubted"] != 0):
        s["rejected"] += 1
        s["doubted"] = 1
        return
    s["silent"] = s["doubted"] = 0
    if math.isfinite(innovation):
        for i in range(REFERENCE_STATES):
            own[i] = s["w"][i] + p["gain"][i] * innovation
        follow_joints(p, p["gain"], p["detuning_pull"], p["swing_floor_um2"], detuning, s["w"], innovation)
        if p["steady"]:
            follow_narrowly(p, s, value_um, gap_s, innovation)
    else:  # the first sample, the first after a gap, or a memory that was lost
        for i in range(REFERENCE_STATES):
            own[i] = 0.0
        own[0] = value_um
        for k in range(MAX_MODES):
            detuning[k] = 0.0
        if p["steady"]:
            narrow_anew(s)
    if p["steady"]:
        give_both(s)
    s["sampled_um"] = value_um
    s["time_ns"] = time_ns


@compiled
def signal_reference(p: Record, s: Record, now_ns: int) -> None:
    """Fill ``s["w"]`` with the signal's reference now; past the horizon its last position is held."""
    age_s = (now_ns - s["time_ns"]) * 1e-9
    if p["predict"] and s["time_ns"] > 0 and is_foreseen(p, s, age_s):
        extrapolate(p, s["detuning"], s["filtered"], age_s, s["w"])
        as_rates(p, s, s["w"])
        return
    for i in range(REFERENCE_STATES):
        s["w"][i] = 0.0
    s["w"][0] = s["sampled_um"]


@compiled.rare
def change_modes(old: Record, new: Record, s: Record) -> None:
    """Carry the filter over to other oscillations: one that `old` did not have begins at rest."""
    keep_detuning(old, new, s)
    first = 3 + 2 * min(old["modes"], new["modes"])
    for i in range(first, REFERENCE_STATES):
        s["filtered"][i] = s["w"][i] = 0.0
    keep_given(old, new, s)


@compiled
def jog_reference(p: Record, s: Record, moves: bool) -> None:
    """Move towards ``target_um``: at most ``speed_um`` per cycle, with smoothed speed."""
    wanted = p["target_um"] - s["jog_um"] if moves else 0.0
    # slow enough to come to rest at the target: the smoothing lets the speed of `smoothing` cycles run on
    step = max(-p["speed_um"], min(p["speed_um"], 0.25 * p["smoothing"] * wanted))
    s["jog_step_um"] += p["smoothing"] * (step - s["jog_step_um"])
    s["jog_um"] += s["jog_step_um"]
    for i in range(REFERENCE_STATES):
        s["w"][i] = 0.0
    s["w"][0] = s["jog_um"]


@compiled
def reference_now(p: Record, s: Record, preview_s: float, now_ns: int, t_s: float, samples: Any) -> None:
    """Reference state ``w`` of this very moment, from the axis' own source or its signal.

    An own source begins at `t_s` 0, and also gives its position `preview_s` ahead: ``ahead_um``.
    """
    if p["kind"] == SIGNAL:
        signal_reference(p, s, now_ns)
        return
    if p["kind"] == JOG:
        jog_reference(p, s, t_s >= 0.0)
    else:
        own_reference(p, s["w"], t_s, samples)
    s["ahead_um"] = s["w"][0]
    if p["kind"] != JOG and preview_s > 0.0:
        s["ahead_um"] = previewed(p, s, t_s + preview_s, samples)
