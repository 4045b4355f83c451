"""Draw the figures of the documentation into docs/pictures: `make docs`.

All are of axis x of the simulated cell, in virtual time. The block diagrams and the play operator beside them are
drawings, edited as SVG.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from micromanip.design.analyse.axis import analyse_axis
from micromanip.design.analyse.loops import strain_loop
from micromanip.design.commission.axis import commission_axis
from micromanip.design.commission.closing import Options
from micromanip.design.commission.report_sections import measured_response, step_response
from micromanip.design.experiment import with_axes, with_reference
from micromanip.design.plots.loops import drawn_plants, loop_plots, loops_of
from micromanip.design.plots.paper import figure_5, figure_7, figure_9, hysteresis_loops
from micromanip.design.report.model import Curve, Plot
from micromanip.design.report.page import thinned
from micromanip.design.validate.evaluation import evaluate
from micromanip.settings.check import Prepared, prepare
from micromanip.settings.schema.reference import Hold
from micromanip.virtual.experiment import VirtualExperiment, with_options

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
_FORCE_N, _FORCE_START_S, _PERIOD_S = 80.0, 4.5, 1e-4
_WIDTH, _DPI = 7.0, 130
Drawing = tuple[str, Sequence[Plot], int]
"""Name of a file, what it shows, in how many columns."""


def force_response(prepared: Prepared, mode: str, offset_um: float) -> tuple[Any, Any]:
    """Time and spindle movement after the force: two runs of one seed, subtracted, so noise-free."""
    held = with_reference(with_axes(prepared.configuration, mode=mode), Hold(source="hold", offset_um=offset_um))
    options: Any = prepared.wiring.options["cell"]
    runs = []
    for force_N in (_FORCE_N, 0.0):
        step = {"start_s": _FORCE_START_S, "static_N": force_N, "rise_ms": 0.01, "tooth_N": 0.0, "noise_N": 0.0}
        forced = options.model_copy(update={"force": options.force.model_copy(update=step)})
        runs.append(VirtualExperiment(with_options(prepared, "cell", forced), process=True)(held, 3.0))
    time = runs[0]["cycle"] * _PERIOD_S - _FORCE_START_S
    moved = runs[0]["axis"]["true_stage_um"][:, 0] - runs[1]["axis"]["true_stage_um"][:, 0]
    shown = (time > -0.02) & (time < 0.4)
    return time[shown], moved[shown]


def force_step(prepared: Prepared) -> Iterator[Plot]:
    """The spindle under a step of force, without and with the outer loop."""
    free = Curve("strain loop alone", *force_response(prepared, "strain", prepared.configuration.axes["x"].centre_um))
    held = Curve("with the outer loop", *force_response(prepared, "stage", 0.0))
    for title, curves in ((f"Spindle after a step of {_FORCE_N:g} N", (free, held)), ("enlarged", (held,))):
        yield Plot(title, "time after the force, s", "movement, um", curves)


def path_error(prepared: Prepared) -> Iterator[Plot]:
    """What is left of the robot's deviation and of the machining force at the spindle."""
    rows = VirtualExperiment(prepared, process=True)(prepared.configuration, 6.0, every=5)
    time, options = rows["cycle"] * _PERIOD_S, prepared.wiring.options["cell"]
    for name, which in (("before", "uncompensated_um"), ("after", "path_error_um")):
        values = rows["axis"][which][:, 0]
        rms_um = np.sqrt(np.mean(values[time > time[0] + 1.0] ** 2))
        title = f"Path error {name} compensation: {rms_um:.3g} um rms; the tool engages at {options.force.start_s:g} s"
        yield Plot(title, "time since the loop's start, s", "um", (Curve("", time, values),))


def drawings(prepared: Prepared, factory: Prepared) -> Iterator[Drawing]:
    """Of the tuned cell, then of what is found when the untuned one is commissioned."""
    configuration, experiment = prepared.configuration, VirtualExperiment(prepared)
    yield "hysteresis", [hysteresis_loops(configuration, experiment, 0)], 1
    yield "control_error", figure_9(evaluate(configuration, experiment), 0), 2
    yield "force_step", [*force_step(prepared)], 1
    yield "path_error", [*path_error(prepared)], 1
    analysis = analyse_axis(configuration, "x", experiment, range(1, 101), jobs=-1)
    assert analysis.inverse is not None
    yield "describing_function", figure_7(analysis.inverse), 2
    loops = loops_of(analysis).items()
    yield "nyquist", [loop_plots(name, *loop)[-1] for name, loop in loops], len(loops)
    yield "drawn_plants", drawn_plants(analysis.samples, analysis.settings.accept), 2
    options = Options(tooth_Hz=200.0)
    found = commission_axis(factory.configuration, VirtualExperiment(factory), "x", lambda _: None, options)
    assert found.outer is not None
    loop = strain_loop(found.pid.inner, found.actuator.system, found.pid.slopes[-1])
    yield "commission_hysteresis", figure_5(found.tanh, found.held_out), 2
    yield "commission_strain", loop_plots("Strain loop", loop, found.pid.margins[-1])[-1:], 1
    gain, _, coherence = measured_response(found.outer.stage)
    yield "commission_stage", [gain, coherence], 2
    yield "commission_outer", [step_response(found.outer.validation)], 1


def drawn(plots: Sequence[Plot], columns: int) -> Figure:
    """The plots below one another, or in several columns."""
    rows = -(-len(plots) // columns)
    figure = Figure(figsize=((_WIDTH, 4.6 * columns)[columns > 1], 3.4 * rows), layout="constrained")
    for panel, plot in zip(figure.subplots(rows, columns, squeeze=False).flat, plots, strict=False):
        for curve in plot.curves:
            x, y = (curve.x, curve.y) if curve.marks else thinned(curve.x, curve.y, log_x=plot.log_x)
            look, alpha = "o" if curve.marks else "-", 0.3 if curve.faint else 1.0
            panel.plot(x, y, look, lw=0.9, ms=3.0, alpha=alpha, label=curve.label)
            for x_here, y_here, text in zip(curve.x, curve.y, curve.texts, strict=False):
                panel.annotate(text, (x_here, y_here), (4, 2), textcoords="offset points", fontsize="x-small")
        panel.set(xlabel=plot.x_label, ylabel=plot.y_label)
        panel.set_title(plot.title, fontsize="medium")
        panel.set_xscale("log" if plot.log_x else "linear")
        panel.set_yscale("log" if plot.log_y else "linear")
        if plot.equal:
            panel.set_aspect("equal", adjustable="datalim")
        panel.grid(alpha=0.3)
        if len(plot.curves) > 1:
            panel.legend(fontsize="small")
    return figure


def save(plots: Sequence[Plot], file: Path, columns: int) -> None:
    """Write a picture of `plots` as SVG; the same plots, the same bytes."""
    with rc_context({"svg.hashsalt": "micromanip"}):
        drawn(plots, columns).savefig(file, dpi=_DPI, metadata={"Date": None})


def main() -> None:
    """Draw everything; the same sources give the same files."""
    cells = (prepare(ROOT / "config" / f"{each}.yaml") for each in ("simulated", "factory"))
    for name, plots, columns in drawings(*cells):
        file = PICTURES / f"{name}.svg"
        save(plots, file, columns)
        sys.stderr.write(f"{file.relative_to(ROOT)}  {file.stat().st_size / 1000:.0f} kB\n")


if __name__ == "__main__":
    main()
