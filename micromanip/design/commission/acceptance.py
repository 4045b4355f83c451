"""Criteria of a commissioned axis: each with its figure and its limit."""

from __future__ import annotations

import numpy as np

from micromanip.design import paper
from micromanip.settings.wiring.timing import AT_ONCE

from ..analysis import AxisAnalysis
from ..criteria import Criterion, criteria
from ..evaluation import Run
from ..tuning import OUTER_DELAY
from .axis import Commissioned
from .quality import COHERENCE, COVERAGE, HELD_OUT_PERCENT, STAGE_FIT_PERCENT

_COUPLING, _SETTLING_S = 0.05, 0.05
_FOLLOWED = 0.7
"""The set-point may move at this share of what the output can do: beyond, the outer loop's model is wrong."""
_COHERENT_HZ = (2.0, 200.0)


def acceptance(found: Commissioned, analysis: AxisAnalysis, runs: list[Run], index: int) -> tuple[Criterion, ...]:
    """All criteria of one axis; `runs`: the paper's experiment with the new tuning, `index`: the axis' place in it."""
    out: list[Criterion] = []

    def add(name: str, passed: bool, value: str, limit: str) -> None:
        out.append(Criterion(found.axis, name, bool(passed), value, limit))

    add("polarity and scale", True, f"{found.polarity.slope_um_per_V:.2f} um/V", "rising, 0.05 to 5 um/V")
    output = found.configuration.outputs[f"voltage_{found.axis}"]
    asked = found.configuration.axes[found.axis].setpoint.slew_um_per_ms
    followed = _FOLLOWED * found.polarity.slope_um_per_V * output.fastest_V_per_s * 1e-3
    add(
        "set-point's slew limit",
        asked <= followed,
        f"{asked:g} um/ms",
        f"<= {followed:.1f} um/ms, 0.7 of the output's",
    )
    share = found.quality.coverage
    add("coverage of the set-points", share >= COVERAGE, f"{100 * share:.0f} %", f">= {100 * COVERAGE:.0f} %")
    best = min(found.held_out_percent.values())
    add(
        "hysteresis on unseen data",
        best <= HELD_OUT_PERCENT,
        f"{best:.2f} % of the stroke",
        f"<= {HELD_OUT_PERCENT:g} %",
    )
    fit = found.stage.fit_percent
    add("stage model on unseen data", fit >= STAGE_FIT_PERCENT, f"{fit:.1f} %", f">= {STAGE_FIT_PERCENT:g} %")
    hertz = found.stage.found.measured.frequency_Hz
    inside = (hertz >= _COHERENT_HZ[0]) & (hertz <= _COHERENT_HZ[1])
    coherence = float(np.median(found.stage.found.measured.coherence[inside]))
    add("coherence of the stage", coherence >= COHERENCE, f"{coherence:.2f}, median 2 to 200 Hz", f">= {COHERENCE:g}")
    out += criteria(analysis)
    for run in runs:
        if run.config == "C":
            sigma, limit = run.figures(found.axis, index)["std_error_um"], paper.SIGMA_UM["C"][run.frequency_hz]
            way = _on_the_way(found, run.frequency_hz)
            wanted = f"<= {limit:g} um (paper, C)"
            if way > 0.0:
                wanted = f"<= {limit + way:.3g} um (paper, C, and {way:.2g} um that the bus is late)"
            add(f"sigma at {run.frequency_hz:g} Hz", sigma <= limit + way, f"{sigma:.4f} um", wanted)
    largest = max(found.validation.coupling.items(), key=lambda entry: abs(entry[1]), default=("none", 0.0))
    value = f"{100 * largest[1]:+.1f} % at {largest[0]}"
    add("cross-coupling", abs(largest[1]) <= _COUPLING, value, f"<= {100 * _COUPLING:.0f} %")
    settling = found.validation.settling_s
    value = f"{1e3 * settling:.0f} ms to 5 %, overshoot {100 * found.validation.overshoot:.0f} %"
    add("stage's step settles", settling <= _SETTLING_S, value, f"within {1e3 * _SETTLING_S:.0f} ms")
    return tuple(out)


def _on_the_way(found: Commissioned, frequency_Hz: float) -> float:
    """Rms (um) by which the paper's sine moves while a set-point is on its way over a bus; 0 without one."""
    path = found.actuator.path
    if path == AT_ONCE:
        return 0.0
    late_s = (OUTER_DELAY + path.output_late) * found.configuration.loop.period_ns * 1e-9
    speed = 2.0 * np.pi * frequency_Hz * paper.reference(frequency_Hz, 0.0).sines[0].amplitude_um
    return float(speed * late_s / np.sqrt(2.0))
