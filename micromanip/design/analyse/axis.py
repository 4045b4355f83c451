"""Analysis of one axis: describing function of its inverse, margins of its loops, limit cycles, robustness.

What an axis lacks (a hysteresis model, an outer model, a recording of its actuator) is left out, and said.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from micromanip.control.margins import Unsure
from micromanip.design.analyse.loops import monte_carlo
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker

from ..experiment import Experiment
from ..identify.actuation import Actuator, identify_actuator
from .loop_analysis import Inverse, Stage, Strain, analyse_inverse, analyse_stage, analyse_strain
from .loops import Sample


@dataclass(frozen=True)
class AxisAnalysis:
    """Everything about one axis; ``missing`` says in words what could not be judged, and why."""

    axis: str
    settings: Axis
    period_s: float
    inverse: Inverse | None
    strain: Strain | None
    stage: Stage | None
    samples: tuple[Sample, ...] = ()
    missing: tuple[str, ...] = field(default=())


def analyse_axis(
    configuration: Configuration,
    axis: str,
    experiment: Experiment | None,
    seeds: range,
    *,
    jobs: int | None = None,
    actuator: Actuator | None = None,
    unsure: Unsure = np.zeros_like,
    progress: Callable[[str], None] = lambda _: None,
) -> AxisAnalysis:
    """Analyse `axis`; `experiment` records its actuator (None: nothing may move), unless `actuator` is known.

    `unsure` gives the uncertainty of the stage's response as a share of it; the outer loop's margins are those within.
    `seeds` draws the plants, one a seed. `progress` is told what comes next.
    """
    settings, missing = configuration.axes[axis], []
    if settings.outer is not None:  # it runs in mode stage alone, around the whole gain of the PID
        settings = settings.model_copy(update={"mode": "stage"})
    period_s = configuration.loop.period_ns * 1e-9
    progress("describing function")
    inverse = None
    if isinstance(settings.hysteresis, PrandtlIshlinskii):
        inverse = analyse_inverse(settings.hysteresis, settings)
    else:
        what = "a network" if settings.hysteresis.model == "network" else "none"
        missing.append(
            f"no describing function: the hysteresis model is {what}, a Prandtl-Ishlinskii model (model: pi) is "
            "needed; `micromanip fit hysteresis` fits one"
        )
    strain = None
    if settings.inner.mode == "feedforward":
        missing.append("no strain loop: inner.mode is feedforward, nothing is fed back from the strain gauge")
    elif actuator is not None:
        strain = analyse_strain(settings, actuator, inverse)
    elif experiment is None:
        missing.append(
            "no margins of the strain loop: its actuator is recorded on a simulated cell only, nothing moves"
        )
    else:
        progress("recording the actuator")
        strain = analyse_strain(settings, identify_actuator(configuration, experiment, axis), inverse)
    progress("outer loop")
    stage = None
    if settings.outer is None:
        missing.append("no margins of the outer loop: the axis has no section outer with an identified model")
    else:
        tracker = configuration.reference.of(axis) if isinstance(configuration.reference, Tracker) else None
        late = experiment.path(configuration, axis).stage_late if experiment is not None else 0
        stage = analyse_stage(settings, tracker, period_s, late, strain, unsure)
    samples: list[Sample] = []
    strain_side, stage_side = strain.side if strain else None, stage.side if stage else None
    if strain_side or stage_side:
        for number, sample in enumerate(monte_carlo(strain_side, stage_side, period_s, seeds, jobs), start=1):
            progress(f"plant {number} of {len(seeds)}")
            samples.append(sample)
    return AxisAnalysis(axis, settings, period_s, inverse, strain, stage, tuple(samples), tuple(missing))
