"""Draw the figures of the documentation into docs/pictures: `make docs`.

All come from the code that they explain: the laws themselves, or the simulated cell in virtual time. The block diagrams
beside them are drawings, edited as SVG.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from scipy.signal import find_peaks

from micromanip.control.outer_gains import outer_gains
from micromanip.design.experiment import with_axes, with_reference
from micromanip.design.plots.canvas import drawn
from micromanip.design.plots.paper import figure_9, hysteresis_loops
from micromanip.design.validate.evaluation import evaluate
from micromanip.rt.laws.hysteresis import play
from micromanip.settings.check import Prepared, prepare
from micromanip.settings.schema.reference import Hold, Step
from micromanip.virtual.experiment import VirtualExperiment, with_options

from .design_figures import analysis_drawings, commissioning_drawings
from .identification import identification_drawings

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "pictures"
_DENSE = 1500
"""Lines of more points are put into the SVG as an image."""
_FORCE_N, _FORCE_START_S = 80.0, 3.0
_PERIOD_S = 1e-4


def panels(count: int, title: str, height: float = 4.2) -> tuple[Figure, Any]:
    """An empty figure with `count` panels below each other."""
    figure = Figure(figsize=(7.0, height), layout="constrained")
    figure.suptitle(title)
    axes = figure.subplots(count, 1, squeeze=False)[:, 0]
    for panel in axes:
        panel.grid(alpha=0.3)
    return figure, axes


def play_operator() -> Figure:
    """One play operator with threshold 2: over time, and over its input."""
    r, w, time = 2.0, 0.0, np.linspace(0.0, 10.0, 1001)
    v = np.interp(time, [0, 1.5, 3.5, 5.5, 7, 8.5, 10], [0, 6, -5, 4, 0.5, 3, -2])
    output = np.empty_like(v)
    for k, value in enumerate(v):
        output[k] = w = play(value, r, w)
    figure = Figure(figsize=(7.5, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(time, v, label="input $v$", lw=1.0)
    left.plot(time, output, label="output $G_r[v]$", lw=1.8)
    left.set(xlabel="time", title="over time")
    left.legend(loc="upper right", fontsize="small")
    ends = np.array([-6.0, 7.0])
    for shift, name in ((-r, "$v - r$"), (r, "$v + r$")):
        right.plot(ends, ends + shift, ":", color="grey", lw=1.0)
        right.annotate(name, (4.9 - shift, 4.9), ha="right", color="grey", xytext=(-4, 2), textcoords="offset points")
    right.plot(v, output, color="tab:orange", lw=1.8)
    right.annotate("", (r, 0), (0, 0), arrowprops={"arrowstyle": "<->", "color": "black"})
    right.text(r / 2, 0.25, "$r$", ha="center")
    right.set(xlabel="input $v$", ylabel="output", title="over the input", xlim=(-6, 7), ylim=(-5, 6.5))
    for panel in (left, right):
        panel.grid(alpha=0.3)
    return figure


def creep(prepared: Prepared) -> Figure:
    """Position after a step, open loop and under the PID's integral action; averaged over 0.1 s."""
    experiment, seconds = VirtualExperiment(prepared), 60.0
    step = Step(source="step", offset_um=20.0, step_um=90.0)
    variants = {
        "open loop": with_reference(with_axes(prepared.configuration, mode="voltage"), step),
        "with the PID": with_reference(
            with_axes(prepared.configuration, mode="strain"), Hold(source="hold", offset_um=90.0)
        ),
    }
    figure, (panel,) = panels(1, "Creep after a step of 90 V")
    for label, variant in variants.items():
        position = experiment(variant, seconds, every=10)["axis"]["true_strain_um"][:, 0]
        position = position.reshape(-1, 100).mean(axis=1)
        after = 0.05 + 0.1 * np.arange(len(position))
        panel.semilogx(after[10:], (position - position[10])[10:], label=label)
    panel.set(xlabel="time after the step, s", ylabel="true actuator position since 1 s, um", xlim=(1.0, seconds))
    panel.legend()
    return figure


def with_force(prepared: Prepared, force_N: float) -> Prepared:
    """The same cell whose machining force is one step and nothing else."""
    for name in prepared.wiring.drivers:
        options: Any = prepared.wiring.options[name]
        updates = {"start_s": _FORCE_START_S, "static_N": force_N, "rise_ms": 0.01, "tooth_N": 0.0, "noise_N": 0.0}
        options = options.model_copy(update={"force": options.force.model_copy(update=updates)})
        prepared = with_options(prepared, name, options)
    return prepared


def force_response(prepared: Prepared, mode: str, offset_um: float) -> tuple[Any, Any]:
    """Time and spindle movement of axis x after the force: two runs of one seed, subtracted, so noise-free."""
    held = with_reference(with_axes(prepared.configuration, mode=mode), Hold(source="hold", offset_um=offset_um))
    runs = [VirtualExperiment(with_force(prepared, f), process=True)(held, 3.0) for f in (_FORCE_N, 0.0)]
    moved = runs[0]["axis"]["true_stage_um"][:, 0] - runs[1]["axis"]["true_stage_um"][:, 0]
    return runs[0]["cycle"] * _PERIOD_S - _FORCE_START_S, moved


def force_step(prepared: Prepared) -> Figure:
    """The spindle under a step of force, without and with the outer loop."""
    axis = prepared.configuration.axes["x"]
    time, free = force_response(prepared, "strain", axis.centre_um)
    _, held = force_response(prepared, "stage", 0.0)
    after = free[time > 0] - free[-1]
    peaks = find_peaks(after)[0][:11]
    decrement = np.log(after[peaks[0]] / after[peaks[10]]) / 10
    ringing_Hz = 10 / ((peaks[10] - peaks[0]) * _PERIOD_S)
    damping = decrement / np.hypot(2 * np.pi, decrement)
    assert axis.outer is not None
    tracker: Any = prepared.configuration.reference
    roots = np.log(outer_gains(axis.outer, tracker.of("x"), _PERIOD_S).closed_loop_poles.astype(complex)) / _PERIOD_S
    mode = min(roots[roots.imag > 0], key=lambda s: abs(abs(s) / (2 * np.pi) - 90.0))
    figure, (both, near) = panels(2, f"Spindle after a step of {_FORCE_N:g} N", 5.4)
    shown = (time > -0.02) & (time < 0.4)
    label = f"strain loop alone: {ringing_Hz:.1f} Hz, damping {damping:.3f}"
    both.plot(time[shown], free[shown], label=label, lw=0.9)
    label = f"with the outer loop: {abs(mode) / (2 * np.pi):.0f} Hz, damping {-mode.real / abs(mode):.2f}"
    for panel in (both, near):
        panel.plot(time[shown], held[shown], color="tab:orange", label=label, lw=1.2)
        panel.set(ylabel="movement, um", xlim=(-0.02, 0.4))
    both.legend(loc="upper right", fontsize="small")
    near.set(xlabel="time after the force, s", title="with the outer loop, enlarged")
    return figure


def path_error(prepared: Prepared) -> Figure:
    """What is left of the robot's deviation and the machining force at the spindle, axis x."""
    rows = VirtualExperiment(prepared, process=True)(prepared.configuration, 6.0, every=5)
    time, axis = rows["cycle"] * _PERIOD_S, rows["axis"][:, 0]
    engages_s = prepared.wiring.options["cell"].force.start_s
    figure, (before, after) = panels(2, "Path error at the spindle, axis x", 5.0)
    for panel, name, colour in ((before, "uncompensated_um", "tab:grey"), (after, "path_error_um", "tab:orange")):
        values = axis[name]
        rms = np.sqrt(np.mean(values[time > time[0] + 1.0] ** 2))
        label = f"{'before' if panel is before else 'after'} compensation: {rms:.3g} um rms"
        panel.plot(time, values, color=colour, lw=0.7, label=label)
        panel.axvline(engages_s, color="tab:red", lw=0.8, ls="--")
        panel.set(ylabel="um", xlim=(time[0], time[-1]))
        panel.legend(loc="upper right", fontsize="small")
    beside = {"xytext": (5, 0), "textcoords": "offset points"}
    before.annotate("tool engages", (engages_s, -180), **beside, color="tab:red", fontsize=8)
    after.set(xlabel="time since the loop's start, s")
    return figure


def drawings() -> Iterator[tuple[str, Figure]]:
    """All figures with the names of their files."""
    yield "play_operator", play_operator()
    prepared = prepare(ROOT / "config" / "simulated.yaml")
    configuration, experiment = prepared.configuration, VirtualExperiment(prepared)
    yield "hysteresis", drawn([hysteresis_loops(configuration, experiment, 0)])
    runs = evaluate(configuration, experiment)
    yield "control_error", drawn(figure_9(runs, 0), columns=2)
    yield "creep", creep(prepared)
    yield "force_step", force_step(prepared)
    yield "path_error", path_error(prepared)
    yield from analysis_drawings(prepared)
    yield from commissioning_drawings(prepare(ROOT / "config" / "factory.yaml"))


def main() -> None:
    """Draw everything; the same sources give the same files."""
    mpl.rcParams["svg.hashsalt"] = "micromanip"
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name, figure in drawings():
        for panel in figure.axes:
            for line in panel.lines:
                line.set_rasterized(len(line.get_xdata()) > _DENSE)
        file = PICTURES / f"{name}.svg"
        figure.savefig(file, dpi=110, metadata={"Date": None, "Creator": None})
        sys.stderr.write(f"{file.relative_to(ROOT)}  {file.stat().st_size / 1000:.0f} kB\n")
    identification_drawings(ROOT / "config" / "factory.yaml", PICTURES)


if __name__ == "__main__":
    main()
