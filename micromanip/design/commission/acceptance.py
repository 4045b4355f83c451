"""Criteria of a commissioned axis: each with its figure and its limit."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np

from micromanip.settings.wiring.timing import AT_ONCE

from ..analyse.axis import AxisAnalysis
from ..analyse.sensitivity import AGREEMENT, KEPT, Sensitivity, kept, least
from ..identify.models import OUTER_DELAY
from ..report.model import Criterion
from ..validate.criteria import Part, criteria, judged, told
from ..validate.evaluation import Run
from ..validate.step import RISE_S, STEP_UM
from .axis import FOLLOWED, Commissioned
from .quality import COHERENCE, COVERAGE, HELD_OUT_PERCENT, STAGE_FIT_PERCENT
from .validation import asked

_COUPLING = 0.05
_SIGMA, _NOISE, _PATH, _PATH_NOISE = 0.01, 1.25, 0.01, 3.0
"""Shares of stroke and amplitude, and multiples of the noise at rest, that are asked for by default."""
_NO_SWING = "no swing that is not there without the loop"
_COHERENT_HZ = (2.0, 200.0)


def acceptance(found: Commissioned, analysis: AxisAnalysis, runs: list[Run], index: int) -> tuple[Criterion, ...]:
    """All criteria of one axis; `runs`: the axis on its sines, `index`: its place in the rows."""
    parts = _found(found), _measured(found, analysis), _sines(found, runs, index), _stage(found), [_coupling(found)]
    identified, *closed = (judged(found.axis, each) for each in parts)
    return *identified, *criteria(analysis), *chain.from_iterable(closed)


def _found(found: Commissioned) -> Iterator[Part]:
    """What was identified, and the strain loop at rest."""
    yield "polarity and scale", True, f"{found.polarity.slope_um_per_V:.2f} um/V", "rising, 0.05 to 5 um/V"
    output = found.configuration.outputs[f"voltage_{found.axis}"]
    asked = found.configuration.axes[found.axis].setpoint.slew_um_per_ms
    followed = FOLLOWED * found.polarity.slope_um_per_V * output.slew_V_per_ms
    limit = f"<= {followed:.1f} um/ms, 0.7 of the output's"
    yield "set-point's slew limit", asked <= followed, f"{asked:g} um/ms", limit
    share = found.quality.coverage
    yield "coverage of the set-points", share >= COVERAGE, f"{100 * share:.0f} %", f">= {100 * COVERAGE:.0f} %"
    best = min(found.held_out_percent.values())
    value, limit = f"{best:.2f} % of the stroke", f"<= {HELD_OUT_PERCENT:g} %"
    yield "hysteresis on unseen data", best <= HELD_OUT_PERCENT, value, limit
    if found.outer is None:
        has_sensor = f"stage_{found.axis}" in found.configuration.signals
        yield "outer loop", not has_sensor, found.without_outer, "one that is proven, with a stage sensor", True
    else:
        fit, measured = found.outer.stage.found.fit_percent, found.outer.stage.found.measured
        limit = f">= {STAGE_FIT_PERCENT:g} %"
        yield "stage model beside the measured response", fit >= STAGE_FIT_PERCENT, f"{fit:.1f} %", limit
        inside = (measured.frequency_Hz >= _COHERENT_HZ[0]) & (measured.frequency_Hz <= _COHERENT_HZ[1])
        coherence = float(np.median(measured.coherence[inside]))
        value = f"{coherence:.2f}, median 2 to 200 Hz"
        yield "coherence of the stage", coherence >= COHERENCE, value, f">= {COHERENCE:g}"
    yield "strain loop: at rest", not found.strain_rest.swings, found.strain_rest.told, _NO_SWING


def _coupling(found: Commissioned) -> Part:
    largest = max(found.coupling.items(), key=lambda entry: abs(entry[1]), default=("none", 0.0))
    value, limit = f"{100 * largest[1]:+.1f} % at {largest[0]}", f"<= {100 * _COUPLING:.0f} %"
    return "cross-coupling", abs(largest[1]) <= _COUPLING, value, limit, True


def _measured(found: Commissioned, analysis: AxisAnalysis) -> Iterator[Part]:
    """Both loops as they were measured while closed, beside what was predicted."""
    for loop in (found.strain_loop, *(() if found.outer is None else (found.outer.loop,))):
        strain = analysis.strain if loop is found.strain_loop else None
        slopes, claimed = ((1.0,), (loop.margins,)) if strain is None else (strain.slopes, strain.margins)
        nominal = loop.measured_margins()
        measured = [nominal] if strain is None else loop.at_slopes(slopes)
        value = (
            f"{nominal.sensitivity:.2f} ({loop.between}), {_reached(nominal.gain_dB, loop)}, "
            f"{nominal.phase_deg:.0f} deg; predicted {loop.margins.sensitivity:.2f}"
        )
        if len(slopes) > 1:
            k = int(np.argmax([m.sensitivity for m in claimed]))
            value += f", {claimed[k].sensitivity:.2f} at {slopes[k]:.2f} times the slope"
        limit = f"distance to -1 within {100 * AGREEMENT:.0f} % of the predicted one, at the nominal slope"
        if not loop.seen:
            value += f" at {loop.margins.peak_Hz:.0f} Hz by the model: measured up to {loop.frequency_Hz[-1]:.0f} Hz"
        yield f"{loop.name}: Ms measured in the loop", loop.agrees, value, limit
        least_dB, least_deg = least(measured)
        said_dB, said_deg = least(claimed)
        value = f"{_reached(least_dB, loop)}, {least_deg:.0f} deg" + (" at the worst slope" if len(slopes) > 1 else "")
        limit = f">= {KEPT:g} of the predicted {said_dB:.1f} dB, {said_deg:.0f} deg"
        yield f"{loop.name}: margins measured in the loop", kept(measured, claimed), value, limit


def _reached(gain_dB: float, loop: Sensitivity) -> str:
    """A gain margin; what lies above the lines was not measured, and is not claimed."""
    return f"{gain_dB:.1f} dB" if np.isfinite(gain_dB) else f"no gain margin below {loop.frequency_Hz[-1]:.0f} Hz"


def _sines(found: Commissioned, runs: list[Run], index: int) -> Iterator[Part]:
    """The sines on the gauge."""
    settings = found.configuration.axes[found.axis]
    (offset_um, amplitude_um), floor = asked(found.configuration, found.axis), found.polarity.noise_um
    slew = settings.setpoint.slew_um_per_ms
    for run in (run for run in runs if run.config == "C"):
        speed = 2e-3 * np.pi * run.frequency_hz * amplitude_um
        sigma, way = run.figures(found.axis, index)["std_error_um"], _on_the_way(found, speed)
        limit = settings.accept.sigma_um or float(np.hypot(_SIGMA * 2.0 * amplitude_um, _NOISE * floor))
        wanted = f"<= {limit:.3g} um" + (f" and {way:.2g} um that the bus is late" if way > 0.0 else "")
        wanted += f": set-point less gauge, {offset_um:.0f} +- {amplitude_um:.0f} um, rms; noise at rest {floor:.3f} um"
        value = f"{told(sigma, limit + way, 3)} um"
        if speed > slew:
            value += f": setpoint.slew_um_per_ms is {slew:g}, the sine takes {speed:.3g}; see accept.stroke_um"
        yield f"sigma at {run.frequency_hz:g} Hz", sigma <= limit + way, value, wanted, True


def _stage(found: Commissioned) -> Iterator[Part]:
    """The stage at rest, on a path, and after a step, as the fresh experiments have it."""
    if found.outer is None:
        return
    check, accept = found.outer.validation, found.configuration.axes[found.axis].accept
    rest = check.rest
    yield "outer loop: at rest", not rest.swings, rest.told, _NO_SWING
    limit = accept.path_error_um or float(np.hypot(_PATH * check.path_amplitude_um, _PATH_NOISE * rest.floor_um))
    wanted = (
        f"<= {limit:.3g} um: reference less stage, +- {check.path_amplitude_um:.0f} um at "
        f"{min(accept.frequencies_Hz):g} Hz, rms; noise at rest {rest.floor_um:.3f} um"
    )
    yield "path error", check.path_um <= limit, f"{told(check.path_um, limit, 3)} um", wanted, True
    settling = 1e3 * check.answer.settling_s
    value = f"{told(settling, accept.settling_ms, 0)} ms to {check.answer.band_um:.2g} um"
    wanted = f"within {accept.settling_ms:g} ms of the beginning of a step of {STEP_UM:g} um in {1e3 * RISE_S:g} ms"
    yield "stage's step settles", settling <= accept.settling_ms, value, wanted, True
    over = 100.0 * check.answer.overshoot
    value = f"{told(over, accept.overshoot_percent, 0)} % beyond its noise"
    yield "stage's step: overshoot", over <= accept.overshoot_percent, value, f"<= {accept.overshoot_percent:g} %", True


def _on_the_way(found: Commissioned, speed_um_per_ms: float) -> float:
    """Rms (um) that a sine of this top speed moves while a set-point is on its way over a bus; 0 without one."""
    path = found.actuator.path
    if path == AT_ONCE:
        return 0.0
    late_s = (OUTER_DELAY + path.output_late) * found.configuration.loop.period_ns * 1e-9
    return float(1e3 * speed_um_per_ms * late_s / np.sqrt(2.0))
