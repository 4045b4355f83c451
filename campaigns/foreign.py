"""Commission plants of a class that nobody designed for; hold what is claimed against their own equations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import joblib
import numpy as np

from micromanip.control.margins import margins
from micromanip.control.outer_gains import outer_gains
from micromanip.control.pid import pid_system
from micromanip.control.stage_loop import stage_loop
from micromanip.design.analyse.describing import harmonics, inverse_operator
from micromanip.design.commission.cell import CommissionedCell, commission_cell
from micromanip.design.commission.closing import Options
from micromanip.design.report.model import Verdict, overall
from micromanip.settings.check import Prepared, prepare
from micromanip.virtual.experiment import VirtualExperiment

from .foreign_plant import Foreign, ForeignCell
from .report import Asked, Report
from .robustness import AXIS, CONFIG, HELD, MARGIN_UM, narrowed, worst

RUNS, WITH_OUTER = 0.9, 0.6
"""Shares of the plants that must end with a file that runs, and with an outer loop in it."""
_SWING_UM, _SWING_V = 1.5, 1.7
_TOP_V = 150.0


@dataclass(frozen=True)
class Outcome:
    """Of one plant. `kept`: the least share of a claimed margin that the true loop has, over all slopes it has."""

    seed: int
    verdict: str
    with_outer: bool
    why: str
    kept: dict[str, float]

    @property
    def runs(self) -> bool:
        """Whether there is a file that runs."""
        return self.verdict in (Verdict.PASS.value, Verdict.LESS.value)

    @property
    def false_pass(self) -> bool:
        """Whether it has margins below 80 % of those claimed."""
        return self.runs and min(self.kept.values()) < HELD

    @property
    def row(self) -> dict[str, object]:
        """Of a table."""
        verdict = "false pass" if self.false_pass else self.verdict
        return {"plant": self.seed, "verdict": verdict, "outer loop": self.with_outer, **self.kept, "why": self.why}


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
    if found.stopped is not None:
        return Outcome(seed, "refused", False, str(found.stopped), {})
    why = "; ".join(f"{c.name}: {c.value}" for c in found.evidence[0].criteria if not c.passed)
    return Outcome(seed, overall(found.evidence).value, found.axes[0].outer is not None, why, held(found, plant))


def held(found: CommissionedCell, plant: Foreign) -> dict[str, float]:
    """Share of each loop's claimed margins that it truly has, at the worst slope of the plant."""
    axis, analysis = found.axes[0], found.analyses[0]
    period_s, settings = found.configuration.loop.period_ns * 1e-9, found.configuration.axes[AXIS]
    assert analysis.strain is not None
    slopes = plant.slopes_um_per_V(axis.actuator.centre_V, _SWING_V, settings.setpoint.range_um)
    plants = [plant.truth(slope, period_s) for slope in slopes]
    pid = pid_system(settings.inner, period_s)  # type: ignore[arg-type]
    compared = [("strain", analysis.strain.margins, [margins(pid.then(each.actuator())) for each in plants])]
    if analysis.stage is not None and settings.outer is not None:
        gain = abs(harmonics(inverse_operator(settings.hysteresis), _SWING_UM, settings.centre_um).gain)
        gains = outer_gains(settings.outer, None, period_s)
        true = [margins(stage_loop(gains, each.behind(settings, gain))) for each in plants]
        compared.append(("outer", (analysis.stage.margins,), true[:1]))
        compared.append(("outer at slopes", tuple(m for _, m in analysis.stage.at_slopes), true))
    kept = {}
    for name, said, real in compared:
        for figure, value in worst(said).items():
            kept[f"{name} {figure}"] = worst(real)[figure] / value
    return kept


def run(asked: Asked) -> Report:
    """`count` plants from `seed` - 1 on; wrong is a false pass, and too few that run."""
    seeds = range(asked.seed - 1, asked.seed - 1 + asked.count)
    results: list[Outcome] = []
    drawn = (joblib.delayed(commission_foreign)(seed) for seed in seeds)
    for outcome in joblib.Parallel(n_jobs=asked.jobs, return_as="generator")(drawn):
        results.append(outcome)
        asked.tell(str(outcome.row))
    runs, outer = sum(each.runs for each in results), sum(each.runs and each.with_outer for each in results)
    wrong = [f"plant {each.seed} passes with false margins" for each in results if each.false_pass]
    if runs < RUNS * len(results) or outer < WITH_OUTER * len(results):
        wrong.append(f"of {len(results)} only {runs} run, {outer} with an outer loop")
    least = min((min(each.kept.values()) for each in results if each.runs), default=float("nan"))
    note = f"{runs} of {len(results)} run, {outer} with an outer loop; least share of a claimed margin {least:.2f}"
    return Report({"share of the claimed margins": [each.row for each in results]}, [note], wrong)
