"""Pictures of what design finds: commissioning of the factory cell, analysis of the tuned one.

All of axis x, in virtual time, for the pages that explain `commission` and `analyse`.
"""

from __future__ import annotations

from collections.abc import Iterator

from matplotlib.figure import Figure

from micromanip.design.analyse.axis import analyse_axis
from micromanip.design.analyse.loops import strain_loop
from micromanip.design.commission.axis import commission_axis
from micromanip.design.commission.closing import Options
from micromanip.design.commission.report_sections import measured_response, step_response
from micromanip.design.plots.canvas import drawn
from micromanip.design.plots.loops import drawn_plants, loop_plots, loops_of
from micromanip.design.plots.paper import figure_5, figure_7
from micromanip.settings.check import Prepared
from micromanip.virtual.experiment import VirtualExperiment

_PLANTS = range(1, 101)


def analysis_drawings(prepared: Prepared) -> Iterator[tuple[str, Figure]]:
    """Describing function, Nyquist curves and drawn plants, with the names of their files."""
    analysis = analyse_axis(prepared.configuration, "x", VirtualExperiment(prepared), _PLANTS, jobs=-1)
    assert analysis.inverse is not None
    yield "describing_function", drawn(figure_7(analysis.inverse), columns=2)
    loops = loops_of(analysis).items()
    yield "nyquist", drawn([loop_plots(name, *loop)[-1] for name, loop in loops], columns=len(loops))
    yield "drawn_plants", drawn(drawn_plants(analysis.samples, analysis.settings.accept), columns=2)


def commissioning_drawings(factory: Prepared) -> Iterator[tuple[str, Figure]]:
    """Residual, strain loop, stage and outer loop, with the names of their files."""
    found = commission_axis(
        factory.configuration, VirtualExperiment(factory), "x", lambda _: None, Options(tooth_Hz=200.0)
    )
    assert found.outer is not None
    loop = strain_loop(found.pid.inner, found.actuator.system, found.pid.slopes[-1])
    yield "commission_hysteresis", drawn(figure_5(found.tanh, found.held_out), columns=2)
    *_, strain_nyquist = loop_plots("Strain loop", loop, found.pid.margins[-1])
    yield "commission_strain", drawn([strain_nyquist])
    gain, _, coherence = measured_response(found.outer.stage)
    yield "commission_stage", drawn([gain, coherence], columns=2)
    yield "commission_outer", drawn([step_response(found.outer.validation)])
