"""Commission cells with drawn plants and hold what is claimed against the plant's own equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import joblib
from micromanip_drivers.simulated.options import Plant

from micromanip.control.margins import Margins
from micromanip.design.analyse.describing import harmonics, inverse_operator
from micromanip.design.commission.cell import CommissionedCell, commission_cell
from micromanip.design.commission.closing import Options
from micromanip.settings.check import Prepared, prepare
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


@dataclass(frozen=True)
class Outcome:
    """Of one plant. ``kept``: the least share of a claimed margin that the true loop has, by loop and figure.

    ``proven``: its tuning runs; ``passed``: as accurately as asked.
    """

    seed: int
    refused: str | None
    proven: bool
    passed: bool
    failed: tuple[str, ...]
    kept: dict[str, float]

    @property
    def false_pass(self) -> bool:
        """A tuning called good whose true margins are below 80 % of those claimed."""
        return self.proven and min(self.kept.values()) < HELD

    @property
    def row(self) -> dict[str, object]:
        """Of a table."""
        proven = "false pass" if self.false_pass else "pass" if self.passed else "less"
        verdict = "refused" if self.refused else proven if self.proven else "fail"
        return {"plant": self.seed, "verdict": verdict, **self.kept, "why": self.refused or "; ".join(self.failed)}


def narrowed(configuration: Configuration, reach_um: float) -> Configuration:
    """Set-points that this actuator can reach, as an engineer would write them down."""
    axis = configuration.axes[AXIS]
    low, high = axis.setpoint.range_um
    setpoint = axis.setpoint.model_copy(update={"range_um": (low, min(high, reach_um - MARGIN_UM))})
    return configuration.model_copy(
        update={"axes": configuration.axes | {AXIS: axis.model_copy(update={"setpoint": setpoint})}}
    )


def commission_drawn(prepared: Prepared, seed: int) -> Outcome:
    """Draw, commission, and compare with the truth."""
    drawn, plant, reach = drawn_cell(prepared, AXIS, seed)
    narrow = narrowed(prepared.configuration, reach)
    found = commission_cell(narrow, VirtualExperiment(drawn), [AXIS], lambda _: None, _KNOBS)
    if found.stopped is not None:
        return Outcome(seed, str(found.stopped), False, False, (), {})
    failed = tuple(f"{c.name}: {c.value}" for c in found.evidence[0].criteria if not c.passed)
    return Outcome(seed, None, found.proven, found.passed, failed, held(found, plant))


def held(found: CommissionedCell, plant: Plant) -> dict[str, float]:
    """Share of each claimed margin that the true loops have."""
    axis, analysis = found.axes[0], found.analyses[0]
    period_s, settings = found.configuration.loop.period_ns * 1e-9, found.configuration.axes[AXIS]
    assert analysis.strain is not None
    centre_V = axis.actuator.centre_V
    true = strain_margins(plant, settings, centre_V, analysis.strain.slopes, period_s)
    compared = [("strain", analysis.strain.margins, true)]
    if analysis.stage is not None:
        gain = abs(harmonics(inverse_operator(settings.hysteresis), _SWING_UM, settings.centre_um).gain)
        compared.append(
            ("outer", (analysis.stage.margins,), [outer_margins(plant, settings, centre_V, gain, period_s)])
        )
    kept = {}
    for name, said, real in compared:
        for figure, value in worst(said).items():
            kept[f"{name} {figure}"] = worst(real)[figure] / value
    return kept


def worst(found: Sequence[Margins]) -> dict[str, float]:
    """The least gain margin (dB), phase margin (deg) and distance from -1; 0 where one is not stable."""
    stable = float(all(m.stable for m in found))
    return {
        "dB": stable * min(m.gain_dB for m in found),
        "deg": stable * min(m.phase_deg for m in found),
        "1/Ms": stable * min(m.modulus for m in found),
    }


def _one(seed: int) -> Outcome:
    """By seed alone, for another process."""
    return commission_drawn(prepare(CONFIG), seed)


def run(asked: Asked) -> Report:
    """`count` plants from `seed` - 1 on; wrong is a false pass, and too few that pass."""
    seeds = range(asked.seed - 1, asked.seed - 1 + asked.count)
    results: list[Outcome] = []
    for outcome in joblib.Parallel(n_jobs=asked.jobs, return_as="generator")(joblib.delayed(_one)(k) for k in seeds):
        results.append(outcome)
        asked.tell(str(outcome.row))
    passed, proven = sum(each.passed for each in results), sum(each.proven for each in results)
    least = min((share for each in results if each.proven for share in each.kept.values()), default=float("nan"))
    wrong = [f"plant {each.seed} passes with false margins" for each in results if each.false_pass]
    if passed < WANTED * len(results):
        wrong.append(f"only {passed} of {len(results)} pass")
    note = (
        f"{passed} of {len(results)} pass, {proven - passed} with less accuracy; the least share of a claimed margin "
        f"among them is {least:.2f}"
    )
    return Report({"share of the claimed margins": [each.row for each in results]}, [note], wrong)
