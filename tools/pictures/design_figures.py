"""Pictures of what design finds: commissioning of the factory cell, analysis of the tuned one.

All of axis x, in virtual time, for the pages that explain `commission` and `analyse`.
"""

from __future__ import annotations

from collections.abc import Iterator

from matplotlib.figure import Figure

from micromanip.design.analysis import analyse_axis
from micromanip.design.analysis_figures import describing_function, drawn_plants, loops_of, nyquist
from micromanip.design.commission.axis import commission_axis
from micromanip.design.commission.evidence import Plot
from micromanip.design.commission.knobs import Knobs
from micromanip.design.commission.plots import figure_5, loop_plots, measured_response, responses
from micromanip.design.loops import strain_loop
from micromanip.settings.check import Prepared
from micromanip.virtual.experiment import VirtualExperiment

_PLANTS = range(1, 101)


def analysis_drawings(prepared: Prepared) -> Iterator[tuple[str, Figure]]:
    """Describing function, Nyquist curves and drawn plants, with the names of their files."""
    analysis = analyse_axis(prepared.configuration, "x", VirtualExperiment(prepared), _PLANTS, jobs=-1)
    assert analysis.inverse is not None
    yield "describing_function", describing_function(analysis.inverse)
    yield "nyquist", nyquist(loops_of(analysis), analysis.settings.accept)
    yield "drawn_plants", drawn_plants(analysis.samples, analysis.settings.accept)


def commissioning_drawings(factory: Prepared) -> Iterator[tuple[str, Figure]]:
    """Residual, strain loop, stage and outer loop, with the names of their files."""
    found = commission_axis(
        factory.configuration, VirtualExperiment(factory), "x", lambda _: None, Knobs(tooth_Hz=200.0)
    )
    loop = strain_loop(found.pid.inner, found.actuator.system, found.pid.slopes[-1])
    yield "commission_hysteresis", beside(*figure_5(found))
    *_, strain_nyquist = loop_plots("Strain loop", loop, found.pid.margins[-1])
    yield "commission_strain", beside(strain_nyquist)
    gain, _, coherence, _ = measured_response(found)
    yield "commission_stage", beside(gain, coherence)
    yield "commission_outer", beside(*responses(found))


def beside(*plots: Plot) -> Figure:
    """The plots side by side."""
    figure = Figure(figsize=(4.6 * len(plots), 3.4), layout="constrained")
    for panel, plot in zip(figure.subplots(1, len(plots), squeeze=False)[0], plots, strict=True):
        for curve in plot.curves:
            look = "o" if curve.marks else "-"
            alpha = 0.3 if curve.faint else 1.0
            panel.plot(curve.x, curve.y, look, lw=0.9, ms=3.0, alpha=alpha, label=curve.label, rasterized=True)
            for x, y, text in zip(curve.x, curve.y, curve.texts, strict=False):
                panel.annotate(text, (x, y), (4, 2), textcoords="offset points", fontsize="x-small")
        panel.set(xlabel=plot.x_label, ylabel=plot.y_label)
        panel.set_title(plot.title, fontsize="medium")
        panel.set_xscale("log" if plot.log_x else "linear")
        panel.set_yscale("log" if plot.log_y else "linear")
        if plot.equal:
            panel.set_aspect("equal", adjustable="datalim")
        panel.grid(alpha=0.3)
        panel.legend(fontsize="small")
    return figure
