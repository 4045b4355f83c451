"""PASS or FAIL for what an analysis found, each criterion with its figure, its limit and where it comes from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from micromanip.control.margins import Margins
from micromanip.design.analyse.loops import HELD_SENSITIVITY, Sample, worst
from micromanip.settings.schema.accept import Accept

from ..analyse.axis import AxisAnalysis
from ..analyse.describing import LimitCycle
from ..report.model import Criterion

Part = tuple[str, bool, str, str] | tuple[str, bool, str, str, bool]
"""Of a criterion: what it is called, whether it is met, its figure, its limit, whether it asks for accuracy alone."""


def judged(axis: str, parts: Iterable[Part]) -> list[Criterion]:
    """The criteria of an axis that these are the parts of."""
    return [Criterion(axis, part[0], bool(part[1]), *part[2:]) for part in parts]


def criteria(analysis: AxisAnalysis) -> list[Criterion]:
    """All criteria that the analysis of one axis allows to judge."""
    return judged(analysis.axis, _parts(analysis))


def _parts(analysis: AxisAnalysis) -> Iterator[Part]:
    accept = analysis.settings.accept
    if analysis.inverse is not None:
        verdict = analysis.inverse.verdict
        least, most = verdict.gain_range_V_per_um
        value = "; ".join(verdict.problems) or f"|N| {least:.2f}..{most:.2f} V/um, no jump, no pole"
        yield "invertible over the set-points", not verdict.problems, value, "regular everywhere"
    if analysis.strain is not None:
        where = [f"at {s:.2f} times the slope" for s in analysis.strain.slopes]
        yield from _loop("strain loop", analysis.strain.margins, where, accept)
        if analysis.inverse is not None:
            yield _none_of("strain loop", analysis.strain.cycles, "V")
    if analysis.stage is not None:
        yield from _loop("outer loop", (analysis.stage.margins,), [""], accept)
        if analysis.stage.at_slopes:
            yield _at_slopes(analysis.stage.at_slopes)
        kept = "dies out" if analysis.stage.rests else "is kept alive by the set-point's slew limit"
        yield "outer loop: a swing of any size", analysis.stage.rests, kept, "dies out"
        if analysis.inverse is not None and analysis.settings.inner.mode != "pid":
            yield _none_of("outer loop", analysis.stage.cycles, "um")
    if analysis.samples:
        yield _drawn(analysis)


def _loop(name: str, found: tuple[Margins, ...], where: list[str], accept: Accept) -> list[Part]:
    """Stability and both margins of a loop at the worst of its variants."""

    def said(i: int, text: str) -> str:
        return f"{text} {where[i]}".strip()

    numbers = range(len(found))
    r = max(numbers, key=lambda i: found[i].radius)
    g = min(numbers, key=lambda i: found[i].gain_dB)
    p = min(numbers, key=lambda i: found[i].phase_deg)
    s = max(numbers, key=lambda i: found[i].sensitivity)
    peak = f"{found[s].sensitivity:.2f} at {found[s].peak_Hz:.3g} Hz"
    return [
        (
            f"{name}: stable",
            all(m.stable for m in found),
            f"largest eigenvalue {found[r].radius:.5f}, Ms " + said(s, peak),
            "inside the unit circle",
        ),
        (
            f"{name}: gain margin",
            all(m.stable and m.gain_dB >= accept.gain_margin_dB for m in found),
            said(g, f"{told(found[g].gain_dB, accept.gain_margin_dB, 1)} dB"),
            f">= {accept.gain_margin_dB:g} dB",
        ),
        (
            f"{name}: phase margin",
            all(m.stable and m.phase_deg >= accept.phase_margin_deg for m in found),
            said(p, f"{told(found[p].phase_deg, accept.phase_margin_deg, 0)} deg at {found[p].phase_Hz:.3g} Hz"),
            f">= {accept.phase_margin_deg:g} deg",
        ),
    ]


def _at_slopes(found: tuple[tuple[float, Margins], ...]) -> Part:
    """The outer loop at the worst slope of the hysteresis, as if its inverse did not follow."""
    slope, worst_there = max(found, key=lambda each: each[1].sensitivity if each[1].stable else np.inf)
    size = f"Ms {told(worst_there.sensitivity, HELD_SENSITIVITY, 2)}" if worst_there.stable else "unstable"
    return (
        "outer loop: at every slope",
        worst_there.stable and worst_there.sensitivity <= HELD_SENSITIVITY,
        f"{size} at {slope:.2f} times the slope, {worst_there.gain_dB:.1f} dB, {worst_there.phase_deg:.0f} deg",
        f"Ms <= {HELD_SENSITIVITY:g}, the feedforward held at its own slope",
    )


def _none_of(name: str, cycles: tuple[LimitCycle, ...], unit: str) -> Part:
    found = "-1/N does not meet the Nyquist curve"
    if cycles:
        smallest = min(cycles, key=lambda c: c.amplitude)
        found = f"amplitude {smallest.amplitude:.3g} {unit} at {smallest.frequency_Hz:.4g} Hz"
    return f"{name}: limit cycle", not cycles, found, "none"


def _drawn(analysis: AxisAnalysis) -> Part:
    """Ms that the accepted share of the drawn plants keeps. With an outer loop it is the whole loop that counts."""
    name, whole = ("outer loop", True) if analysis.stage is not None else ("strain loop", False)
    accept, share = analysis.settings.accept, analysis.settings.accept.robust_percent
    found = np.array([_sensitivity(s, whole=whole) for s in analysis.samples])
    kept = float(np.quantile(found, 0.01 * share, method="inverted_cdf"))
    case = worst(list(analysis.samples), of_stage=whole)
    size = "unstable" if not np.isfinite(found.max()) else f"Ms {found.max():.2f}"
    least = "no bound" if not np.isfinite(kept) else f"Ms {told(kept, accept.robust_sensitivity, 2)}"
    value = f"{least} for {share:g} % of {len(found)}, worst {size} with seed {case.seed}"
    limit = f"Ms <= {accept.robust_sensitivity:g} for {share:g} %"
    return f"{name}: drawn plants", kept <= accept.robust_sensitivity, value, limit


def _sensitivity(case: Sample, *, whole: bool) -> float:
    loop = case.stage if whole else case.strain
    return loop.sensitivity if loop is not None and loop.stable else float("inf")


def told(value: float, limit: float, decimals: int) -> str:
    """`value` with enough digits to be seen on its side of `limit`."""
    while decimals < 6 and value != limit and (round(value, decimals) - limit) * (value - limit) <= 0.0:
        decimals += 1
    return f"{value:.{decimals}f}"


def notes(analysis: AxisAnalysis) -> list[str]:
    """What is no criterion but worth knowing: plants for which only the outer loop keeps the strain loop stable."""
    said = list(analysis.missing)
    alone = [s for s in analysis.samples if s.strain is not None and s.stage is not None]
    lost = [s for s in alone if s.strain is not None and not s.strain.stable]
    if lost:
        said.append(
            f"by itself, while the outer loop is not closed, the strain loop is unstable for {len(lost)} of "
            f"{len(alone)} drawn plants, e.g. seed {lost[0].seed}: it takes damping from the flexure's mode"
        )
    return said


def report(analysis: AxisAnalysis) -> dict[str, Any]:
    """Everything of one axis as plain values, ready for JSON."""
    document: dict[str, Any] = {
        "axis": analysis.axis,
        "criteria": [asdict(c) for c in criteria(analysis)],
        "notes": notes(analysis),
    }
    if analysis.inverse is not None:
        swept, gain = analysis.inverse.swept, analysis.inverse.swept.gain_V_per_um
        document["describing"] = asdict(analysis.inverse.verdict) | {
            "offset_um": swept.offset_um,
            "thresholds_um": analysis.inverse.thresholds_um.tolist(),
            "amplitude_um": swept.amplitude_um.tolist(),
            "v0_V": swept.v0_V.tolist(),
            "gain_V_per_um": abs(gain).tolist(),
        }
    if analysis.strain is not None:
        strain = analysis.strain
        document["strain"] = {
            "fit_percent": strain.actuator.found.fit_percent,
            "slopes": list(strain.slopes),
            "margins": [_margins(m) for m in strain.margins],
            "limit_cycles": [asdict(c) for c in strain.cycles],
        }
    if analysis.stage is not None:
        document["stage"] = {
            "margins": _margins(analysis.stage.margins),
            "at_slopes": [{"slope": slope, **_margins(found)} for slope, found in analysis.stage.at_slopes],
            "limit_cycles": [asdict(c) for c in analysis.stage.cycles],
        }
    document["samples"] = [
        {"seed": s.seed, "drawn": asdict(s.drawn), "stable": s.stable}
        | {name: _margins(m) for name, m in (("strain", s.strain), ("stage", s.stage)) if m is not None}
        for s in analysis.samples
    ]
    return document


def _margins(m: Margins) -> dict[str, Any]:
    return asdict(m) | {"gain_dB": m.gain_dB, "sensitivity": m.sensitivity, "stable": m.stable}
