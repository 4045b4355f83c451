"""Commission plants of a class that nobody designed for; hold what is claimed against their own equations."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from micromanip.control.margins import margins
from micromanip.control.outer_gains import outer_gains
from micromanip.control.pid import pid_system
from micromanip.control.stage_loop import stage_loop
from micromanip.design.analyse.describing import harmonics, inverse_operator
from micromanip.design.commission.cell import CommissionedCell, commission_cell
from micromanip.design.commission.closing import Options
from micromanip.settings.check import Prepared, prepare
from micromanip.virtual.experiment import VirtualExperiment

from .foreign_plant import Foreign, ForeignCell
from .report import Asked, Report
from .robustness import AXIS, CONFIG, MARGIN_UM, Compared, Outcome, judged, narrowed

RUNS, WITH_OUTER = 0.9, 0.6
"""Shares of the plants that must end with a file that runs, and with an outer loop in it."""
_SWING_UM, _SWING_V = 1.5, 1.7
_TOP_V = 150.0


def foreign_cell(prepared: Prepared, plant: Foreign) -> Prepared:
    """The cell with `plant` in its only axis, the set-points narrowed to what it reaches."""
    driver = prepared.wiring.drivers["cell"]
    cell = ForeignCell.of(plant, driver.options, prepared.configuration.loop.period_ns)  # type: ignore[attr-defined]
    way = np.linspace(0.0, _TOP_V, 1500)
    moved = plant.free_um(way)
    narrow = narrowed(prepared.configuration, float(moved[-1] - moved[0]) - MARGIN_UM)
    return replace(prepared, wiring=replace(prepared.wiring, drivers={"cell": cell}), configuration=narrow)


def commission_foreign(seed: int) -> Outcome:
    """Draw, commission, and compare with the truth."""
    plant = Foreign.drawn(seed)
    prepared = foreign_cell(prepare(CONFIG), plant)
    found = commission_cell(prepared.configuration, VirtualExperiment(prepared), [AXIS], lambda _: None, Options())
    return Outcome.of(seed, found, partial(held, plant=plant))


def held(found: CommissionedCell, plant: Foreign) -> Compared:
    """Each loop with its claimed margins and those that it truly has, at all slopes of the plant."""
    axis, analysis = found.axes[0], found.analyses[0]
    period_s, settings = found.configuration.loop.period_ns * 1e-9, found.configuration.axes[AXIS]
    assert analysis.strain is not None
    slopes = plant.slopes_um_per_V(axis.actuator.centre_V, _SWING_V, settings.setpoint.range_um)
    plants = [plant.truth(slope, period_s) for slope in slopes]
    pid = pid_system(settings.inner, period_s)  # type: ignore[arg-type]
    compared: Compared = [("strain", analysis.strain.margins, [margins(pid.then(each.actuator())) for each in plants])]
    if analysis.stage is not None and settings.outer is not None:
        gain = abs(harmonics(inverse_operator(settings.hysteresis), _SWING_UM, settings.centre_um).gain)
        gains = outer_gains(settings.outer, None, period_s)
        true = [margins(stage_loop(gains, each.behind(settings, gain))) for each in plants]
        compared.append(("outer", (analysis.stage.margins,), true[:1]))
        compared.append(("outer at slopes", tuple(m for _, m in analysis.stage.at_slopes), true))
    return compared


def _too_few(results: list[Outcome]) -> str | None:
    runs, outer = sum(each.runs for each in results), sum(each.runs and each.with_outer for each in results)
    missed = runs < RUNS * len(results) or outer < WITH_OUTER * len(results)
    return f"of {len(results)} only {runs} run, {outer} with an outer loop" if missed else None


def run(asked: Asked) -> Report:
    """Wrong is a false pass, and too few that run."""
    return judged(asked, commission_foreign, _too_few)
