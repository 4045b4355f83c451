"""From the section ``reference`` to the record of its law: one source, or the predictor of a signal."""

from __future__ import annotations

import math
from typing import Any

from micromanip.control.outer_gains import tracker_gain
from micromanip.rt.laws import reference as law
from micromanip.settings.schema.reference import File, Hold, Jog, Reference, Sines, Step, Tracker

_JOG_SMOOTHING_S = 0.05


def fill_reference(r: Any, reference: Reference, column: int, axis: str, rate_hz: int) -> None:
    """Fill a REFERENCE_PARAMETERS record for `axis`, whose samples of a file stand in `column`."""
    r["oscillator"] = 2 * math.pi
    r["jump_um"] = math.inf
    if isinstance(reference, Tracker):
        r["kind"], r["predict"] = law.SIGNAL, reference.predict
        r["oscillator"] = 2 * math.pi * reference.oscillation_Hz
        r["gain"] = tracker_gain(reference)
        r["horizon_s"] = reference.horizon_ms * 1e-3
        r["low_um"], r["high_um"] = reference.range_um
        r["jump_um"] = math.inf if reference.jump_um is None else reference.jump_um
        return
    if isinstance(reference, File):
        r["kind"], r["column"], r["samples_per_s"] = law.SAMPLES, column, rate_hz
        return
    r["offset_um"], r["start_s"] = reference.offset_um, reference.start_s
    if isinstance(reference, Hold):
        r["kind"] = law.HOLD
    elif isinstance(reference, Jog):
        r["kind"] = law.JOG
        r["target_um"] = reference.target_um.get(axis, reference.offset_um)
        r["speed_um"] = reference.speed_um_per_s / rate_hz
        r["smoothing"] = -math.expm1(-1.0 / (_JOG_SMOOTHING_S * rate_hz))
    elif isinstance(reference, Step):
        r["kind"], r["step_um"] = law.STEP, reference.step_um
    elif isinstance(reference, Sines):
        r["kind"], r["sines"] = law.SINES, len(reference.sines)
        for k, sine in enumerate(reference.sines):
            r["amplitude_um"][k] = sine.amplitude_um
            r["omega"][k] = 2 * math.pi * sine.frequency_Hz
            r["phase"][k] = math.radians(sine.phase_deg)
