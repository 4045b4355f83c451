"""Pictures like the paper's figures 2, 5, 8 and 9, as SVG."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from micromanip.rt.records import MAX_AXES
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import File

from . import paper
from .canvas import panels, save
from .evaluation import Run
from .excitation import shrinking_triangle
from .experiment import Experiment, with_axes, with_reference

_COLOURS = {"A": "tab:blue", "B": "tab:red", "C": "tab:green"}

Array = NDArray[np.float64]


def hysteresis_loops(configuration: Configuration, experiment: Experiment, axis: int) -> Figure:
    """Figure 2: linear, alternately rising and falling voltage with shrinking amplitude."""
    rate = configuration.loop.rate_hz
    triangle = shrinking_triangle(0.0, 140.0, 6, rate)
    samples = np.tile(triangle[:, None], (1, MAX_AXES))
    wave = with_reference(with_axes(configuration, mode="voltage"), File(source="file", path="(triangle)"))
    rows = experiment(wave, len(triangle) / rate, samples, every=20)
    figure, (panel,) = panels(1, "Hysteresis of the actuator (open loop)")
    panel.plot(rows["axis"]["voltage_V"][:, axis], rows["axis"]["strain_um"][:, axis], lw=0.8)
    panel.set(xlabel="voltage, V", ylabel="displacement at the strain gauge, um")
    panel.grid(alpha=0.3)
    return figure


def control_errors(runs: list[Run], axis: int, rate_hz: int) -> Figure:
    """Figure 8: the control error of the three configurations at 5 and 10 Hz."""
    figure, both = panels(2, "Control error, sine of 30 um about 70 um", 1.5)
    for panel, frequency in zip(both, (5.0, 10.0), strict=True):
        for run in runs:
            if run.frequency_hz == frequency and run.config in _COLOURS:
                error = run.error_um(axis)[run.settled : run.settled + round(0.6 * rate_hz)]
                label = f"{run.config}: {paper.LABELS[run.config]}"
                panel.plot(np.arange(len(error)) / rate_hz, error, color=_COLOURS[run.config], lw=0.6, label=label)
        panel.set(xlabel="time, s", ylabel="error, um", title=f"{frequency:g} Hz")
        panel.grid(alpha=0.3)
    both[0].legend(loc="upper right", fontsize="small")
    return figure


def input_output(runs: list[Run], axis: int) -> Figure:
    """Figure 9: position over reference at 10 Hz; feedback alone leaves a loop open, the inverse closes it."""
    figure, (panel, near) = panels(2, "Input-output behaviour at 10 Hz", 1.5)
    for run in runs:
        if run.frequency_hz == 10.0 and run.config in _COLOURS:
            rows = run.rows[run.settled :]["axis"]
            reference, strain = rows["reference_um"][:, axis], rows["strain_um"][:, axis]
            panel.plot(reference, strain, color=_COLOURS[run.config], lw=0.6, label=paper.LABELS[run.config])
            near.plot(reference, strain - reference, ".", ms=0.6, color=_COLOURS[run.config], rasterized=True)
    panel.set(xlabel="reference, um", ylabel="position, um")
    near.set(xlabel="reference, um", ylabel="position - reference, um")
    panel.legend()
    for each in (panel, near):
        each.grid(alpha=0.3)
    return figure


def draw_all(
    configuration: Configuration, experiment: Experiment, runs: list[Run], axis: int, folder: Path, about: str = ""
) -> Iterator[Path]:
    """Draw the pictures of one axis into `folder`, one after the other; `about` says where they come from."""
    rate = configuration.loop.rate_hz
    drawings: list[tuple[str, Callable[[], Figure]]] = [
        ("figure2_hysteresis", lambda: hysteresis_loops(configuration, experiment, axis)),
        ("figure8_control_error", lambda: control_errors(runs, axis, rate)),
        ("figure9_input_output", lambda: input_output(runs, axis)),
    ]
    name = list(configuration.axes)[axis]
    for title, draw in drawings:
        yield save(draw(), folder, f"{title}_{name}", about=about)
