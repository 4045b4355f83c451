"""Pictures of docs/commissioning.md: plots of the report of axis x of the factory cell."""

from __future__ import annotations

from collections.abc import Iterator

from matplotlib.figure import Figure

from micromanip.design.commission.axis import commission_axis
from micromanip.design.commission.evidence import Plot
from micromanip.design.commission.plots import figure_5, loop_plots, measured_response, responses
from micromanip.design.loops import strain_loop
from micromanip.settings.check import Prepared
from micromanip.virtual.experiment import VirtualExperiment


def commissioning_drawings(factory: Prepared) -> Iterator[tuple[str, Figure]]:
    """Residual, strain loop, stage and outer loop, with the names of their files."""
    found = commission_axis(factory.configuration, VirtualExperiment(factory), "x", lambda _: None)
    loop = strain_loop(found.pid.inner, found.actuator.system, found.pid.slopes[-1])
    yield "commission_hysteresis", beside(*figure_5(found))
    *_, strain_nyquist = loop_plots("Strain loop", loop, found.pid.margins[-1])
    yield "commission_strain", beside(strain_nyquist)
    gain, _, coherence = measured_response(found)
    yield "commission_stage", beside(gain, coherence)
    yield "commission_outer", beside(*responses(found))


def beside(*plots: Plot) -> Figure:
    """The plots side by side."""
    figure = Figure(figsize=(4.6 * len(plots), 3.4), layout="constrained")
    for panel, plot in zip(figure.subplots(1, len(plots), squeeze=False)[0], plots, strict=True):
        for curve in plot.curves:
            panel.plot(
                curve.x, curve.y, ".-" if curve.marks else "-", lw=0.9, ms=2.0, label=curve.label, rasterized=True
            )
        panel.set(xlabel=plot.x_label, ylabel=plot.y_label)
        panel.set_title(plot.title, fontsize="medium")
        panel.set_xscale("log" if plot.log_x else "linear")
        panel.set_yscale("log" if plot.log_y else "linear")
        if plot.equal:
            panel.set_aspect("equal", adjustable="datalim")
        panel.grid(alpha=0.3)
        panel.legend(fontsize="small")
    return figure
