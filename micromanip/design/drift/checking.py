"""One check of an axis: which of its loops are measured, and what becomes of their responses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime

import numpy as np

from micromanip.control.system import System
from micromanip.design.live_margins import judge_running
from micromanip.design.response import Measured
from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.model import Configuration
from micromanip.settings.tuning_hash import tuning_hash
from micromanip.settings.wiring.timing import FeedbackPath

from .figures import PlantFigures, commissioned, plant_figures
from .history import MARGINS, Check

DRAWS = 1
"""Injections for each loop: 5 s; what one tells less than two is told by the checks before."""


def closed_loops(axis: Axis, name: str) -> tuple[str, ...]:
    """The loops of an axis that can be measured; CheckFailed where there is none."""
    stage = ("stage",) if axis.mode == "stage" and axis.outer is not None else ()
    strain = ("strain",) if axis.mode != "voltage" and axis.inner.mode != "feedforward" else ()
    if not stage + strain:
        raise CheckFailed(
            f"axis {name}: no loop is closed (mode {axis.mode}, inner.mode {axis.inner.mode}): nothing to measure"
        )
    return stage + strain


def of_the_model(axis: Axis, period_s: float) -> PlantFigures:
    """The figures of the model in the configuration; NaN where it has none."""
    if axis.outer is None:
        return PlantFigures()
    A, B, C = (np.array(part) for part in (axis.outer.model.A, axis.outer.model.B, axis.outer.model.C))
    return commissioned(System(A, B, C, 0.0, period_s))


def checked(
    configuration: Configuration, path: FeedbackPath, axis: str, responses: Mapping[str, Measured], time: datetime
) -> Check:
    """The check that `responses`, by the names of their loops, make at `time`."""
    settings = configuration.axes[axis]
    tuned = of_the_model(settings, configuration.loop.period_ns * 1e-9)
    figures = asdict(plant_figures(responses.get("stage"), responses.get("strain"), tuned))
    figures |= dict.fromkeys(MARGINS, math.nan)
    deviations: dict[str, float] = {}
    if "stage" in responses:
        found = judge_running(configuration, path, axis, "stage", responses["stage"])
        margins = found.measured[found.nominal]
        figures |= dict(zip(MARGINS, (margins.gain_dB, margins.phase_deg), strict=True))
        deviations = dict(zip(MARGINS, found.loop.margin_deviations(), strict=True))
    return Check(time, axis, tuning_hash(settings), figures, deviations)
