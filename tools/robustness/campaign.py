"""Commission cells with drawn plants and hold what is claimed against the plant's own equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from micromanip_drivers.simulated.options import Plant

from micromanip.control.margins import Margins
from micromanip.design.commission.cell import CommissionedCell, commission_cell
from micromanip.design.commission.knobs import Knobs
from micromanip.design.describing import harmonics, inverse_operator
from micromanip.settings.check import Prepared
from micromanip.settings.schema.model import Configuration
from micromanip.virtual.experiment import VirtualExperiment

from .family import drawn_cell
from .truth import outer_margins, strain_margins

CONFIG = Path(__file__).with_name("cell.yaml")
AXIS, MARGIN_UM, HELD = "x", 3.0, 0.8
_SWING_UM = 1.5
_KNOBS = Knobs(tooth_Hz=200.0)


@dataclass(frozen=True)
class Outcome:
    """Of one plant. ``kept``: the least share of a claimed margin that the true loop has, by loop and figure."""

    seed: int
    plant: dict[str, object]
    refused: str | None
    passed: bool
    failed: tuple[str, ...]
    kept: dict[str, float]
    claimed: dict[str, float]

    @property
    def false_pass(self) -> bool:
        """A tuning called good whose true margins are below 80 % of those claimed."""
        return self.passed and min(self.kept.values()) < HELD

    @property
    def line(self) -> str:
        """For people."""
        verdict = "refused" if self.refused else "PASS" if self.passed else "FAIL"
        kept = " ".join(f"{name} {share:.2f}" for name, share in self.kept.items())
        said = self.refused or "; ".join(self.failed)
        return f"{self.seed:4} {'FALSE PASS' if self.false_pass else verdict:10} {kept}  {said}"


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
        return Outcome(seed, described(plant), str(found.stopped), False, (), {}, {})
    kept, claimed = held(found, plant)
    failed = tuple(f"{c.name}: {c.value}" for c in found.evidence[0].criteria if not c.passed)
    return Outcome(seed, described(plant), None, found.passed, failed, kept, claimed)


def described(plant: Plant) -> dict[str, object]:
    """What of the plant is not as usual."""
    usual = Plant().model_dump()
    return {name: value for name, value in plant.model_dump().items() if value != usual[name]}


def held(found: CommissionedCell, plant: Plant) -> tuple[dict[str, float], dict[str, float]]:
    """Share of each claimed margin that the true loops have, and what was claimed."""
    axis, analysis = found.axes[0], found.analyses[0]
    period_s, settings = found.configuration.loop.period_ns * 1e-9, found.configuration.axes[AXIS]
    assert analysis.strain is not None
    assert analysis.stage is not None
    centre_V = axis.actuator.centre_V
    true = strain_margins(plant, settings, centre_V, analysis.strain.slopes, period_s)
    gain = abs(harmonics(inverse_operator(axis.tanh.model), _SWING_UM, settings.centre_um).gain)
    outer = outer_margins(plant, settings, centre_V, gain, period_s)
    kept, claimed = {}, {}
    for name, said, real in (
        ("strain", analysis.strain.margins, true),
        ("outer", (analysis.stage.margins,), [outer]),
    ):
        for figure, value in worst(said).items():
            kept[f"{name} {figure}"] = worst(real)[figure] / value
            claimed[f"{name} {figure}"] = value
    return kept, claimed


def worst(found: Sequence[Margins]) -> dict[str, float]:
    """The least gain margin (dB), phase margin (deg) and distance from -1; 0 where one is not stable."""
    stable = float(all(m.stable for m in found))
    return {
        "dB": stable * min(m.gain_dB for m in found),
        "deg": stable * min(m.phase_deg for m in found),
        "1/Ms": stable * min(m.modulus for m in found),
    }
