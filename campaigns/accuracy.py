"""What the cell reaches: path error and the paper's sines, of our axes and of drawn plants, beside the causal bound.

Virtual time. Each cell is commissioned from factory values; its path error is that of the trial at the end, in which
the process goes on, on other noise than it was commissioned with.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np

from micromanip.design.commission.cell import CommissionedCell
from micromanip.design.commission.closing import Options
from micromanip.design.parallel import each
from micromanip.design.validate import paper
from micromanip.design.validate.evaluation import TUNED, evaluate, table
from micromanip.errors import CheckFailed
from micromanip.settings.check import Prepared, prepared
from micromanip.settings.text.source import Source
from micromanip.virtual.experiment import VirtualExperiment

from .drawn_plants import drawn_cell, narrowed
from .report import CONFIG, Asked, Report
from .tune import commissioned, missed

FACTORY, AXIS, FIRST_PLANT, SLEW_UM_PER_MS, TRIAL_SEED = CONFIG / "factory.yaml", "x", 200, 10.0, 7
"""Where all begin; axis, first seed and the slew limit of the set-point of the drawn plants, as in the campaign
`robustness`; seed of the trial's noise."""
_TRUTHS = ("true_strain", "true_stage", "path_error", "uncompensated")
UNCOMPENSATED, LEFT, BOUND, LIMITED = (
    "uncompensated",
    "as `commission` leaves it",
    "causal bound",
    "time at an end of the actuator's range, %",
)
PATH, GAUGE, TRUE = (
    "Path error, um rms",
    "Sines on the gauge, sigma by the gauge, um",
    "Sines on the gauge, true sigma, um",
)
Values = dict[str, float]
"""By column of a table."""
Reached = dict[str, Values]
"""By title of a table."""


def factory(axes: str) -> Prepared:
    """The example config/factory.yaml with `axes` alone, which knows the truth."""
    source = Source.read(FACTORY)
    document: Any = copy.deepcopy(dict(source.data))
    signals = {f"{kind}_{axis}": {"driver": "cell"} for kind in _TRUTHS for axis in axes}
    document["signals"] = signals | {k: v for k, v in document["signals"].items() if k[-1] in axes}
    for section in ("outputs", "axes"):
        document[section] = {k: v for k, v in document[section].items() if k[-1] in axes}
    cell = document["drivers"]["cell"]
    cell["axes"], cell["variation"] = [*axes], {k: v for k, v in cell["variation"].items() if k in axes}
    return prepared(Source.of(document, FACTORY))


def sines(cell: Prepared, found: CommissionedCell) -> list[dict[str, Any]]:
    """Rows of `evaluate`; of a plant with which the paper's PID ends in a fault, those with its own PID alone."""
    configuration, experiment = found.configuration, VirtualExperiment(cell)
    try:
        return table(evaluate(configuration, experiment, tuned=True), configuration)
    except CheckFailed:
        own = table(evaluate(configuration, experiment, own_pid=True), configuration)
        return [row | {"config": TUNED} for row in own if row["config"] == "C"]  # D is C with another PID


def reached(cell: Prepared) -> dict[str, Reached] | str:
    """By axis, what the cell reaches once it is commissioned, or why it does not pass."""
    found = commissioned(cell, lambda _: None, Options(), trial_seed=TRIAL_SEED)
    if not found.passed or found.production is None or not found.production.budgets:
        return "; ".join(missed(found))
    rows, reaches = sines(cell, found), {}
    for axis, seen in found.production.seen.items():
        bound = found.production.budgets[axis].bound.rms_um
        path = {UNCOMPENSATED: seen.uncompensated_rms, LEFT: seen.rms, BOUND: bound, LIMITED: seen.limited_percent}
        gauge, true = (
            {f"{row['config']} {row['frequency_hz']:g} Hz": row[key] for row in rows if row["axis"] == axis}
            for key in ("std_error_um", "true_std_error_um")
        )
        reaches[axis] = {PATH: path, GAUGE: gauge, TRUE: true}
    return reaches


def drawn_plant(seed: int) -> Reached | str:
    """What the plant of `seed` reaches, or why it does not pass."""
    cell, _, reach_um = drawn_cell(factory(AXIS), AXIS, seed)
    found = reached(narrowed(cell, AXIS, reach_um, slew_um_per_ms=SLEW_UM_PER_MS))
    return found if isinstance(found, str) else found[AXIS]


def spread(found: Sequence[Values]) -> list[dict[str, Any]]:
    """Rows for median and worst of drawn plants."""
    columns = dict.fromkeys(column for each_plant in found for column in each_plant)
    every = {column: [values[column] for values in found if column in values] for column in columns}
    return [
        {"": f"drawn, {name}"} | {column: float(of(values)) for column, values in every.items()}
        for name, of in (("median", np.median), ("worst", max))
    ]


def run(asked: Asked) -> Report:
    """Our axes and `count` drawn plants; wrong is a path error below the bound or above the motion."""
    own = reached(factory("xyz"))
    if isinstance(own, str):
        return Report(wrong=[own])
    report, plants = Report(), {}
    seeds = range(FIRST_PLANT, FIRST_PLANT + asked.count)
    for seed, plant in zip(seeds, each(drawn_plant, seeds, jobs=asked.jobs), strict=True):
        if isinstance(plant, str):
            report.notes.append(f"plant {seed} does not pass: {plant}")
        else:
            plants[f"plant {seed}"] = plant
        asked.tell(f"plant {seed}: {plant if isinstance(plant, str) else plant[PATH][LEFT]}")
    published = {f"{letter} {hz:g} Hz": um for letter, row in paper.SIGMA_UM.items() for hz, um in row.items()}
    for title in (PATH, GAUGE, TRUE):
        rows = [{"": axis} | values[title] for axis, values in own.items()]
        report.tables[title] = rows + (spread([plant[title] for plant in plants.values()]) if plants else [])
    report.tables[GAUGE] = [{"": "paper"} | published, *report.tables[GAUGE]]
    report.notes.append(f"{len(plants)} of {asked.count} drawn plants pass")
    free = [plant[PATH][LEFT] for plant in plants.values() if not plant[PATH][LIMITED]]
    if free:
        median = f"the median of the {len(free)} that never came to an end of their range"
        report.notes.append(f"{median} is {np.median(free):.3f} um")
    for name, values in (own | plants).items():
        path = values[PATH]
        if not path[BOUND] < path[LEFT] < path[UNCOMPENSATED]:
            report.wrong.append(f"{name}: {path[LEFT]:.3f} um is not between bound and what moves")
    return report
