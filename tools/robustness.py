"""Commission axis x of cells with drawn plants, and count who does as well as the paper: `make robustness`."""

from __future__ import annotations

import sys
from pathlib import Path

from micromanip.design import paper
from micromanip.design.commission.cell import commission_cell
from micromanip.errors import CheckFailed
from micromanip.settings.check import Prepared, prepare
from micromanip.settings.schema.model import Configuration
from micromanip.virtual.drawn_plants import drawn_cell
from micromanip.virtual.experiment import VirtualExperiment

CONFIG = Path(__file__).resolve().parent.parent / "config" / "factory.yaml"
AXIS, PLANTS, WANTED = "x", 50, 46
MARGIN_UM = 3.0


def narrowed(configuration: Configuration, reach_um: float) -> Configuration:
    """Set-points that this actuator can reach, as an engineer would write them down."""
    axis = configuration.axes[AXIS]
    low, high = axis.setpoint.range_um
    setpoint = axis.setpoint.model_copy(update={"range_um": (low, min(high, reach_um - MARGIN_UM))})
    return configuration.model_copy(
        update={"axes": configuration.axes | {AXIS: axis.model_copy(update={"setpoint": setpoint})}}
    )


def commission_drawn(prepared: Prepared, seed: int) -> dict[str, object]:
    """Figures of one plant: sigma at 5 and 10 Hz in C, whether it is stable and what was refused."""
    drawn, _, reach = drawn_cell(prepared, AXIS, seed)
    configuration = narrowed(prepared.configuration, reach)
    try:
        found = commission_cell(configuration, VirtualExperiment(drawn), [AXIS], lambda _: None)
    except CheckFailed as problem:
        return {"seed": seed, "reach_um": reach, "refused": str(problem), "good": False, "stable": False}
    criteria = {criterion.name: criterion for criterion in found.evidence[0].criteria}
    sigma = {f: criteria[f"sigma at {f:g} Hz"] for f in (5.0, 10.0)}
    stable = all(criteria[name].passed for name in ("strain loop: stable", "outer loop: stable"))
    return {
        "seed": seed,
        "reach_um": reach,
        "refused": None,
        "good": all(criterion.passed for criterion in sigma.values()),
        "stable": stable,
        "sigma": {f: criterion.value for f, criterion in sigma.items()},
        "failed": [f"{c.name}: {c.value}" for c in found.evidence[0].criteria if not c.passed],
    }


def main() -> int:
    """A line a plant; exit code 1 where fewer are good than wanted, or one is unstable."""
    prepared = prepare(CONFIG)
    results = []
    for seed in range(PLANTS):
        results.append(commission_drawn(prepared, seed))
        sys.stdout.write(f"{results[-1]}\n")
        sys.stdout.flush()
    good, stable = (sum(bool(result[key]) for result in results) for key in ("good", "stable"))
    limits = ", ".join(f"{paper.SIGMA_UM['C'][f]:g} um at {f:g} Hz" for f in (5.0, 10.0))
    sys.stdout.write(f"{good} of {PLANTS} at or below {limits}; {stable} stable\n")
    return 0 if good >= WANTED and stable == PLANTS else 1


if __name__ == "__main__":
    sys.exit(main())
