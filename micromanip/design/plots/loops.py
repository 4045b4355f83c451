"""Plots of an analysis: Bode and Nyquist plots of a loop, describing function, drawn plants."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from micromanip.control.margins import Margins, grid, refined
from micromanip.control.system import Array, System
from micromanip.design.analyse.loops import Sample
from micromanip.settings.schema.accept import Accept

from ..analyse.axis import AxisAnalysis
from ..report.model import Curve, Plot, Section
from .paper import figure_7

_FAR, _HIGHEST = 3.0, 1e4
_MARKED_HZ = (5, 10, 20, 50, 100, 200, 500, 1000, 2000)


def loop_plots(name: str, loop: System, found: Margins) -> tuple[Plot, ...]:
    """Bode and Nyquist plot of an open loop."""
    omega, L = refined(
        loop.response, grid(loop.period_s, np.concatenate([loop.poles, np.linalg.eigvals(loop.closed())]))
    )
    # an oscillator in the controller is a pole on the unit circle: its peak would be all that one sees
    kept = (omega > 2 * np.pi) & (np.abs(L) < _HIGHEST)
    hertz, L = omega[kept] / (2 * np.pi), L[kept]
    near = np.abs(L) < _FAR
    turn = np.exp(1j * np.linspace(0.0, 2 * np.pi, 181))
    circle = found.modulus * turn - 1.0
    note = f"Gain margin {found.gain_dB:.1f} dB, phase margin {found.phase_deg:.0f} deg, Ms {found.sensitivity:.2f}."
    marked = [(each, int(np.argmin(np.abs(hertz - each)))) for each in _MARKED_HZ if hertz[0] < each < hertz[-1]]
    marked = [(each, k) for each, k in marked if near[k]]
    at = L[[k for _, k in marked]]
    nyquist = (
        Curve("L", np.where(near, L.real, np.nan), np.where(near, L.imag, np.nan)),
        Curve(f"Ms {found.sensitivity:.2f}: distance to -1", circle.real, circle.imag),
        Curve("Hz", at.real, at.imag, marks=True, texts=tuple(str(each) for each, _ in marked)),
        Curve("-1", np.array([-1.0]), np.array([0.0]), marks=True),
        Curve("unit circle", turn.real, turn.imag, faint=True),
    )
    phase = np.degrees(np.angle(L))
    phase[1:][np.abs(np.diff(phase)) > 180.0] = np.nan
    return (
        Plot(f"{name}: gain", "frequency, Hz", "|L|", (Curve("|L|", hertz, np.abs(L)),), note, log_x=True, log_y=True),
        Plot(
            f"{name}: phase",
            "frequency, Hz",
            "degrees",
            (Curve("L", hertz, phase),),
            log_x=True,
        ),
        Plot(f"{name}: Nyquist", "real part", "imaginary part", nyquist, note, equal=True),
    )


_MOST_MS = 20.0
"""An Ms above it is drawn there, and that of an unstable plant."""


def drawn_plants(samples: tuple[Sample, ...], accept: Accept) -> tuple[Plot, Plot]:
    """Ms and phase margin of each drawn plant, and Ms over what matters most; unstable ones at the largest Ms."""
    margins, places = [], []
    for name, of in (("strain loop", "strain"), ("outer loop", "stage")):
        found: list[tuple[Sample, Margins]] = [(s, m) for s in samples if (m := getattr(s, of)) is not None]
        for what, stable in ((name, True), (f"{name}, unstable", False)):
            kept = [(s, m) for s, m in found if m.stable is stable]
            if kept:
                size = _array(min(m.sensitivity, _MOST_MS) if stable else _MOST_MS for _, m in kept)
                phase = _array(min(m.phase_deg, 90.0) if stable else 0.0 for _, m in kept)
                label = f"{what}: {len(kept)} of {len(found)}"
                margins.append(Curve(label, size, phase, marks=True))
                over = _array(np.sqrt(s.drawn.stiffness / s.drawn.stage_mass) for s, _ in kept)
                places.append(Curve(label, over, size, marks=True))
    ends = _array(each for curve in places for each in (curve.x.min(), curve.x.max()))
    limit = _array([accept.robust_sensitivity] * 2)
    places.append(Curve("limit", _array([ends.min(), ends.max()]), limit, faint=True))
    title, what = f"Margins of {len(samples)} drawn plants", "frequency of the flexure's mode over its nominal one"
    return (
        Plot(title, f"Ms, at most {_MOST_MS:g}", "phase margin, degrees", tuple(margins), log_x=True),
        Plot("Where they are lost", what, "Ms", tuple(places), log_y=True),
    )


def _array(values: Iterable[float]) -> Array:
    return np.array(list(values), dtype=float)


def loops_of(analysis: AxisAnalysis) -> dict[str, tuple[System, Margins]]:
    """The loops that there are by name: the strain loop at the identified slope, and at the worst if another."""
    loops: dict[str, tuple[System, Margins]] = {}
    if analysis.strain is not None:
        i = int(np.argmin(np.abs(np.array(analysis.strain.slopes) - 1.0)))
        loops["strain loop, identified slope"] = analysis.strain.loops[i], analysis.strain.margins[i]
        k = int(np.argmax([m.sensitivity for m in analysis.strain.margins]))
        if k != i:
            name = f"strain loop, worst slope ({analysis.strain.slopes[k]:.2f} times)"
            loops[name] = analysis.strain.loops[k], analysis.strain.margins[k]
    if analysis.stage is not None:
        loops["outer loop"] = analysis.stage.loop, analysis.stage.margins
    return loops


def analysis_sections(analysis: AxisAnalysis, about: str) -> Iterator[Section]:
    """What the analysis of one axis has; `about` says where it comes from."""
    axis = f"Axis {analysis.axis}"
    if analysis.inverse is not None:
        yield Section(f"{axis}: inverse", about, {}, figure_7(analysis.inverse))
    for name, (loop, found) in loops_of(analysis).items():
        yield Section(f"{axis}: {name}", about, {}, loop_plots(name.partition(",")[0].capitalize(), loop, found))
    if analysis.samples:
        yield Section(f"{axis}: drawn plants", about, {}, drawn_plants(analysis.samples, analysis.settings.accept))
