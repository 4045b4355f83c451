"""What a tuned cell reaches: tracked paths, what bounds them, sines of the paper, and fast ones."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from micromanip.design import paper
from micromanip.design.budget.causes import FORCE, PREDICTION, TRACKER
from micromanip.design.budget.configured import bound_of, cell_of
from micromanip.design.evaluation import TUNED, evaluate, evaluate_fast, fast_table, table
from micromanip.errors import CheckFailed
from micromanip.settings.check import Prepared
from micromanip.virtual.experiment import VirtualExperiment, with_options
from micromanip.virtual.switched import at_limits, simulated_driver

PLAYED_SEED, PLAYED_S, AFTER_TOOL_S, LEAST_S, COHERENCE_S = 7, 10.0, 1.0, 2.0, 1.0
"""Seed of the noise that is played; virtual time that counts, after the tool's entry and after tracking began; for how
long the bound takes phases to be known."""
FASTER = 1.06
"""The joints' frequency in another pose of the robot than that which was commissioned, in terms of that."""
UNCOMPENSATED, BEFORE, NOW, MOVED, BOUND, LIMITED = (
    "uncompensated",
    "`config/simulated.yaml`",
    "as `commission` leaves it",
    "the same, the joints swinging 6 % faster than then",
    "causal bound",
    "time at an end of the actuator's range, %",
)
PATH_ROWS = (UNCOMPENSATED, BEFORE, NOW, MOVED, BOUND, LIMITED)
SEEN, SEEN_BOUND, FORCED, FORCED_BOUND = (
    "tracker: noise, delay, rate, prediction",
    "causal bound of the path",
    "force",
    "causal bound of the force",
)
_AS_TUNED = "C"
"""Of the paper's configurations: what `TUNED` is with another PID."""
Values = dict[str, float]
"""By row of a table."""


@dataclass(frozen=True)
class Reached:
    """Of one axis, um, by row: rms of the path error; causes of it; sigma of the gauge on sines, measured and true.

    `fast` is the true sigma of fast sines.
    """

    path: Values
    causes: Values
    gauge: Values
    true_gauge: Values
    fast: Values

    @property
    def bears_the_papers_pid(self) -> bool:
        """False where the paper's one PID ended in a limit cycle."""
        return any(row.startswith(_AS_TUNED) for row in self.gauge)


def played(prepared: Prepared, faster: float = 1.0) -> dict[str, Values]:
    """By axis, of what `prepared` tracks: rms (um) of the path error, uncompensated too; how much is out of reach.

    The robot's joints swing `faster` than the cell's options say.
    """
    name, configuration = simulated_driver(prepared), prepared.configuration
    driver: Any = prepared.wiring.drivers[name]
    deviation = driver.options.deviation
    moved = deviation.model_copy(update={"joint_Hz": faster * deviation.joint_Hz})
    options = driver.options.model_copy(update={"seed": PLAYED_SEED, "deviation": moved})
    experiment = VirtualExperiment(with_options(prepared, name, options), process=True)
    cell = experiment.cell(configuration)
    passed = len(cell.arm()) * configuration.loop.period_ns * 1e-9
    cell.run(max(LEAST_S, options.force.start_s + AFTER_TOOL_S - passed))
    rows = cell.run(PLAYED_S)
    experiment.require_no_fault(cell)
    axes, limited, found = rows["axis"], at_limits(configuration, rows), {}
    for i, axis in enumerate(configuration.axes):
        moved, left = (float(np.sqrt(np.mean(axes[f][:, i] ** 2))) for f in ("uncompensated_um", "path_error_um"))
        found[axis] = {UNCOMPENSATED: moved, NOW: left, LIMITED: 100.0 * float(np.mean(limited[:, i]))}
    return found


def causes(prepared: Prepared, axis: str) -> Values:
    """Computed, um rms: what the tracker's samples and the force leave, each with the least that any law leaves."""
    cell = cell_of(prepared, axis)
    assert cell.known is not None
    powers, bound = cell.powers()[1], bound_of(cell, cell.known, COHERENCE_S)
    variances = {
        SEEN: sum(float(powers[name].sum()) for name in (TRACKER, PREDICTION)),
        SEEN_BOUND: bound.path_um2,
        FORCED: float(powers[FORCE].sum()),
        FORCED_BOUND: bound.force_um2,
    }
    return {row: float(np.sqrt(um2)) for row, um2 in variances.items()}


def sines(prepared: Prepared) -> list[dict[str, Any]]:
    """Rows of `evaluate`; of a plant with which the paper's PID ends in a fault, those with its own PID alone."""
    configuration, experiment = prepared.configuration, VirtualExperiment(prepared)
    try:
        return table(evaluate(configuration, experiment, tuned=True), configuration)
    except CheckFailed:
        own = table(evaluate(configuration, experiment, own_pid=True), configuration)
        return [row | {"config": TUNED} for row in own if row["config"] == _AS_TUNED]


def fast_sines(prepared: Prepared) -> list[dict[str, Any]]:
    """Rows of `evaluate`: of D those of the fast sines."""
    configuration, experiment = prepared.configuration, VirtualExperiment(prepared)
    fast = fast_table(evaluate_fast(configuration, experiment, tuned=True), configuration)
    return [row for row in fast if row["config"] == TUNED]


def true_sigma(rows: Iterable[dict[str, Any]]) -> Values:
    """True sigma by configuration and frequency; of small sines the rms as a share of the stroke, too."""
    found = {}
    for row in rows:
        if row["refused"] is None:
            what = f"{row['config']} {row['frequency_hz']:g} Hz, {row['amplitude_um']:g} um"
            found[what] = row["true_std_error_um"]
            if row["amplitude_um"] == paper.FAST_UM:
                found[f"{what}, % of the stroke"] = row["true_rms_percent"]
    return found


def reached(prepared: Prepared) -> dict[str, Reached]:
    """By axis, of a tuned cell that tracks."""
    tracked, other, rows = played(prepared), played(prepared, FASTER), sines(prepared)
    fast = fast_sines(prepared)
    found = {}
    for axis in prepared.configuration.axes:
        known = causes(prepared, axis)
        bound = float(np.hypot(known[SEEN_BOUND], known[FORCED_BOUND]))
        gauge, true = (
            {f"{row['config']} {row['frequency_hz']:g}": row[key] for row in rows if row["axis"] == axis}
            for key in ("std_error_um", "true_std_error_um")
        )
        path = tracked[axis] | {MOVED: other[axis][NOW], BOUND: bound}
        path = {row: path[row] for row in PATH_ROWS if row != BEFORE}
        found[axis] = Reached(path, known, gauge, true, true_sigma(row for row in fast if row["axis"] == axis))
    return found
