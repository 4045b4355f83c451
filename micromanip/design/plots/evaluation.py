"""The paper's figures 2, 8 and 9 of an evaluation, as SVG."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from micromanip.rt.records import MAX_AXES
from micromanip.settings.schema.model import Configuration

from ..evaluation import Run
from ..excitation import shrinking_triangle
from ..experiment import Experiment, open_loop
from ..report.model import Plot
from .canvas import save
from .paper import figure_2, figure_8, figure_9


def hysteresis_loops(configuration: Configuration, experiment: Experiment, axis: int) -> Plot:
    """Figure 2 of an experiment: linear, alternately rising and falling voltage with shrinking amplitude."""
    rate = configuration.loop.rate_hz
    triangle = shrinking_triangle(0.0, 140.0, 6, rate)
    samples = np.tile(triangle[:, None], (1, MAX_AXES))
    rows = experiment(open_loop(configuration), len(triangle) / rate, samples, every=20)["axis"]
    return figure_2(rows["voltage_V"][:, axis], rows["strain_um"][:, axis])


def draw_all(
    configuration: Configuration, experiment: Experiment, runs: list[Run], axis: int, folder: Path, about: str = ""
) -> Iterator[Path]:
    """Draw the pictures of one axis into `folder`, one after the other; `about` says where they come from."""
    name = list(configuration.axes)[axis]
    loops = hysteresis_loops(configuration, experiment, axis)
    yield save([loops], folder, f"figure2_hysteresis_{name}", about=about)
    yield save(figure_8(runs, axis), folder, f"figure8_control_error_{name}", about=about)
    yield save(figure_9(runs, axis), folder, f"figure9_over_phase_{name}", columns=2, about=about)
