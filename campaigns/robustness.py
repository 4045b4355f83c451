"""Commission cells with drawn plants of two classes; hold what is claimed against the plants' own equations.

The campaign `robustness` draws plants of the simulation (``drawn_plants``), `foreign` such as nobody designed for
(``foreign_plant``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import joblib
import numpy as np

from micromanip.control.margins import Margins, margins
from micromanip.control.outer_gains import outer_gains
from micromanip.control.pid import pid_system
from micromanip.control.stage_loop import stage_loop
from micromanip.design.analyse.describing import harmonics, inverse_operator
from micromanip.design.commission.cell import CommissionedCell, commission_cell
from micromanip.design.commission.closing import Options
from micromanip.design.report.model import Verdict, overall
from micromanip.settings.check import Prepared, prepare
from micromanip.virtual.experiment import VirtualExperiment

from . import foreign_plant as foreign
from .drawn_plants import MARGIN_UM, SWING_V, drawn_cell, narrowed, small_slope, true_plant
from .report import CONFIGURATIONS, Asked, Report
from .true_plant import TruePlant

CONFIG = CONFIGURATIONS / "robustness.yaml"
AXIS, HELD = "x", 0.8
LEAST = {"robustness": {"pass": 0.85}, "foreign": {"run": 0.9, "run with an outer loop": 0.6}}
"""Shares of the plants that must end so."""
_SWING_UM = 1.5
Compared = list[tuple[str, Sequence[Margins], Sequence[Margins]]]
"""Loops with their claimed and their true margins."""
Truths = Callable[[CommissionedCell], list[TruePlant]]
"""What a commissioned plant truly is: for a small swing, then at each slope for which the strain loop is claimed."""


def drawn(prepared: Prepared, seed: int) -> tuple[Prepared, Truths]:
    """The cell with a plant of the simulation's class."""
    cell, plant, reach_um = drawn_cell(prepared, AXIS, seed)

    def truths(found: CommissionedCell) -> list[TruePlant]:
        small, strain = small_slope(plant, found.axes[0].actuator.centre_V), found.analyses[0].strain
        assert strain is not None
        return [true_plant(plant, s * small, _period_s(found)) for s in (1.0, *strain.slopes)]

    return narrowed(cell, AXIS, reach_um), truths


def foreign_cell(prepared: Prepared, seed: int) -> tuple[Prepared, Truths]:
    """The cell with a plant of another class in its only axis."""
    configuration, driver = prepared.configuration, prepared.wiring.drivers["cell"]
    plant = foreign.drawn(seed, configuration.loop.period_ns * 1e-9)
    cell = foreign.ForeignCell(driver.options, configuration.loop.period_ns)  # type: ignore[attr-defined]
    cell.plant = plant
    moved_um = foreign.free_um(plant, np.linspace(0.0, foreign.HIGH_V, 1500))
    prepared = replace(prepared, wiring=replace(prepared.wiring, drivers={"cell": cell}))

    def truths(found: CommissionedCell) -> list[TruePlant]:
        range_um = found.configuration.axes[AXIS].setpoint.range_um
        slopes = foreign.slopes_um_per_V(plant, found.axes[0].actuator.centre_V, SWING_V, range_um)
        return [foreign.truth(plant, slope) for slope in (slopes[0], *slopes)]

    return narrowed(prepared, AXIS, float(moved_um[-1] - moved_um[0]) - MARGIN_UM), truths


CLASSES = {"robustness": (drawn, Options(tooth_Hz=200.0)), "foreign": (foreign_cell, Options())}


def _period_s(found: CommissionedCell) -> float:
    return found.configuration.loop.period_ns * 1e-9


@dataclass(frozen=True)
class Outcome:
    """Of one plant. `kept`: the least share of a claimed margin that the true loop has, by loop and figure."""

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


def commission_plant(kind: str, seed: int) -> Outcome:
    """Draw, commission, and compare with the truth."""
    cell_of, options = CLASSES[kind]
    cell, truths = cell_of(prepare(CONFIG), seed)
    found = commission_cell(cell.configuration, VirtualExperiment(cell), [AXIS], lambda _: None, options)
    if found.stopped is not None:
        return Outcome(seed, "refused", False, str(found.stopped), {})
    why = "; ".join(f"{c.name}: {c.value}" for c in found.evidence[0].criteria if not c.passed)
    kept = {
        f"{name} {figure}": worst(true)[figure] / value
        for name, said, true in compared(found, truths(found), at_slopes=kind == "foreign")
        for figure, value in worst(said).items()
    }
    return Outcome(seed, overall(found.evidence).value, found.axes[0].outer is not None, why, kept)


def compared(found: CommissionedCell, truths: list[TruePlant], *, at_slopes: bool) -> Compared:
    """Each loop with its claimed and its true margins; `at_slopes`: the outer loop at every slope, too."""
    analysis, settings, (nominal, *others) = found.analyses[0], found.configuration.axes[AXIS], truths
    assert analysis.strain is not None
    pid = pid_system(settings.inner, _period_s(found))  # type: ignore[arg-type]
    loops: Compared = [("strain", analysis.strain.margins, [margins(pid.then(each.actuator())) for each in others])]
    if analysis.stage is not None and settings.outer is not None:
        gain = abs(harmonics(inverse_operator(settings.hysteresis), _SWING_UM, settings.centre_um).gain)
        gains = outer_gains(settings.outer, None, _period_s(found))

        def outer(plants: list[TruePlant]) -> list[Margins]:
            return [margins(stage_loop(gains, each.behind(settings, gain))) for each in plants]

        loops.append(("outer", (analysis.stage.margins,), outer([nominal])))
        if at_slopes:
            loops.append(("outer at slopes", tuple(m for _, m in analysis.stage.at_slopes), outer(others)))
    return loops


def worst(found: Sequence[Margins]) -> dict[str, float]:
    """The least gain margin (dB), phase margin (deg) and distance from -1; 0 where one is not stable."""
    stable = float(all(m.stable for m in found))
    return {
        "dB": stable * min(m.gain_dB for m in found),
        "deg": stable * min(m.phase_deg for m in found),
        "1/Ms": stable * min(m.modulus for m in found),
    }


def run(asked: Asked) -> Report:
    """`count` plants from `seed` - 1 on; wrong is a false pass, and too few that end well."""
    results: list[Outcome] = []
    one = joblib.delayed(partial(commission_plant, asked.name))
    for outcome in joblib.Parallel(asked.jobs, return_as="generator")(
        one(asked.seed - 1 + k) for k in range(asked.count)
    ):
        results.append(outcome)
        asked.tell(str(outcome.row))
    running = [each for each in results if each.runs]
    counts = {
        "pass": sum(each.verdict == Verdict.PASS.value for each in results),
        "run": len(running),
        "run with an outer loop": sum(each.with_outer for each in running),
    }
    least = min((min(each.kept.values()) for each in running), default=float("nan"))
    note = f"of {len(results)} {', '.join(f'{count} {name}' for name, count in counts.items())}; "
    note += f"the least share of a claimed margin among those that run is {least:.2f}"
    wrong = [f"plant {each.seed} passes with false margins" for each in results if each.false_pass]
    for name, share in LEAST[asked.name].items():
        if counts[name] < share * len(results):
            wrong.append(f"only {counts[name]} of {len(results)} {name}")
    return Report({"share of the claimed margins": [each.row for each in results]}, [note], wrong)
