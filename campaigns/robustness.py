"""Commission cells with drawn plants and hold what is claimed against the plant's own equations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import joblib
from micromanip_drivers.simulated.options import Plant

from micromanip.control.margins import Margins
from micromanip.design.analyse.describing import harmonics, inverse_operator
from micromanip.design.commission.cell import CommissionedCell, commission_cell
from micromanip.design.commission.closing import Options
from micromanip.design.report.model import Verdict, overall
from micromanip.settings.check import prepare
from micromanip.settings.schema.model import Configuration
from micromanip.virtual.experiment import VirtualExperiment

from .drawn_plants import drawn_cell
from .report import CONFIGURATIONS, Asked, Report
from .true_plant import outer_margins, strain_margins

CONFIG = CONFIGURATIONS / "robustness.yaml"
WANTED = 0.85
"""Share of the plants that must pass."""
AXIS, MARGIN_UM, HELD = "x", 3.0, 0.8
_SWING_UM = 1.5
_KNOBS = Options(tooth_Hz=200.0)
Compared = list[tuple[str, Sequence[Margins], Sequence[Margins]]]
"""Loops with their claimed and their true margins."""


@dataclass(frozen=True)
class Outcome:
    """Of one plant. `kept`: the least share of a claimed margin that the true loop has, by loop and figure."""

    seed: int
    verdict: str
    with_outer: bool
    why: str
    kept: dict[str, float]

    @classmethod
    def of(cls, seed: int, found: CommissionedCell, held: Callable[[CommissionedCell], Compared]) -> Outcome:
        """What was `found` beside the claimed and the true margins of each loop, which `held` gives."""
        if found.stopped is not None:
            return cls(seed, "refused", False, str(found.stopped), {})
        why = "; ".join(f"{c.name}: {c.value}" for c in found.evidence[0].criteria if not c.passed)
        kept = {
            f"{name} {figure}": worst(real)[figure] / value
            for name, said, real in held(found)
            for figure, value in worst(said).items()
        }
        return cls(seed, overall(found.evidence).value, found.axes[0].outer is not None, why, kept)

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


def narrowed(configuration: Configuration, reach_um: float) -> Configuration:
    """Set-points that this actuator can reach, as an engineer would write them down."""
    axis = configuration.axes[AXIS]
    low, high = axis.setpoint.range_um
    setpoint = axis.setpoint.model_copy(update={"range_um": (low, min(high, reach_um - MARGIN_UM))})
    return configuration.model_copy(
        update={"axes": configuration.axes | {AXIS: axis.model_copy(update={"setpoint": setpoint})}}
    )


def commission_drawn(seed: int) -> Outcome:
    """Draw, commission, and compare with the truth."""
    prepared = prepare(CONFIG)
    drawn, plant, reach = drawn_cell(prepared, AXIS, seed)
    narrow = narrowed(prepared.configuration, reach)
    found = commission_cell(narrow, VirtualExperiment(drawn), [AXIS], lambda _: None, _KNOBS)
    return Outcome.of(seed, found, partial(held, plant=plant))


def held(found: CommissionedCell, plant: Plant) -> Compared:
    """Each loop with its claimed and its true margins."""
    axis, analysis = found.axes[0], found.analyses[0]
    period_s, settings = found.configuration.loop.period_ns * 1e-9, found.configuration.axes[AXIS]
    assert analysis.strain is not None
    centre_V = axis.actuator.centre_V
    true = strain_margins(plant, settings, centre_V, analysis.strain.slopes, period_s)
    compared: Compared = [("strain", analysis.strain.margins, true)]
    if analysis.stage is not None:
        gain = abs(harmonics(inverse_operator(settings.hysteresis), _SWING_UM, settings.centre_um).gain)
        compared.append(
            ("outer", (analysis.stage.margins,), [outer_margins(plant, settings, centre_V, gain, period_s)])
        )
    return compared


def worst(found: Sequence[Margins]) -> dict[str, float]:
    """The least gain margin (dB), phase margin (deg) and distance from -1; 0 where one is not stable."""
    stable = float(all(m.stable for m in found))
    return {
        "dB": stable * min(m.gain_dB for m in found),
        "deg": stable * min(m.phase_deg for m in found),
        "1/Ms": stable * min(m.modulus for m in found),
    }


def judged(asked: Asked, one: Callable[[int], Outcome], wanted: Callable[[list[Outcome]], str | None]) -> Report:
    """`count` plants from `seed` - 1 on; wrong is a false pass, and what `wanted` misses."""
    results: list[Outcome] = []
    drawn = (joblib.delayed(one)(asked.seed - 1 + k) for k in range(asked.count))
    for outcome in joblib.Parallel(n_jobs=asked.jobs, return_as="generator")(drawn):
        results.append(outcome)
        asked.tell(str(outcome.row))
    wrong = [f"plant {each.seed} passes with false margins" for each in results if each.false_pass]
    wrong += filter(None, [wanted(results)])
    passed, running = sum(each.verdict == Verdict.PASS.value for each in results), [e for e in results if e.runs]
    outer = sum(each.with_outer for each in running)
    least = min((min(each.kept.values()) for each in running), default=float("nan"))
    note = (
        f"{passed} of {len(results)} pass, {len(running) - passed} with less accuracy, {outer} have an outer loop; the "
        f"least share of a claimed margin among them is {least:.2f}"
    )
    return Report({"share of the claimed margins": [each.row for each in results]}, [note], wrong)


def _too_few(results: list[Outcome]) -> str | None:
    passed = sum(each.verdict == Verdict.PASS.value for each in results)
    return f"only {passed} of {len(results)} pass" if passed < WANTED * len(results) else None


def run(asked: Asked) -> Report:
    """Wrong is a false pass, and too few that pass."""
    return judged(asked, commission_drawn, _too_few)
