"""What the cell reaches: path error and the paper's sines, of our axes and of drawn plants, beside the causal bound.

Virtual time, by the simulation's truth; the real loop beside it. Each cell is commissioned from factory values, and
played with the process, on other noise than it was commissioned with.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml

from micromanip.design.analyse.budget.recorded import budget_of
from micromanip.design.parallel import each
from micromanip.design.validate import paper
from micromanip.design.validate.evaluation import TUNED, evaluate, table
from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.settings.check import Prepared
from micromanip.settings.schema.model import Configuration
from micromanip.virtual.experiment import VirtualExperiment, at_limit, with_options

from .report import Asked, Report
from .running_controller import MICROMANIP
from .simulated_cells import AXIS, FIRST_PLANT, commissioned, drawn, of_axes, tuned

PLAYED_SEED, PLAYED_S, AFTER_TOOL_S, LEAST_S, COHERENCE_S, REAL_S = 7, 10.0, 1.0, 2.0, 1.0, 20.0
"""Seed of the noise that is played; virtual time that counts, after the tool's entry and after tracking began; for how
long the bound takes phases to be known; how long the real loop runs."""
FASTER = 1.06
"""The joints' frequency in another pose of the robot than that which was commissioned, in terms of that."""
UNCOMPENSATED, LEFT, MOVED, BOUND, LIMITED = (
    "uncompensated",
    "as `commission` leaves it",
    "the same, the joints 6 % faster",
    "causal bound",
    "time at an end of the actuator's range, %",
)
PATH, GAUGE, TRUE, REAL = (
    "Path error, um rms",
    "Sines on the gauge, sigma by the gauge, um",
    "Sines on the gauge, true sigma, um",
    "Path error of the real loop, um",
)
Values = dict[str, float]
"""By row of a table."""
Reached = dict[str, Values]
"""By title of a table."""


def played(prepared: Prepared, faster: float = 1.0) -> dict[str, Values]:
    """By axis, what is left of the path while the robot's joints swing `faster` than the cell's options say.

    And the least (um rms) that any causal law leaves of the motion that was played.
    """
    configuration, driver = prepared.configuration, cast(Any, prepared.wiring.drivers["cell"])
    deviation = driver.options.deviation
    moved = deviation.model_copy(update={"joint_Hz": faster * deviation.joint_Hz})
    options = driver.options.model_copy(update={"seed": PLAYED_SEED, "deviation": moved})
    experiment = VirtualExperiment(with_options(prepared, "cell", options), process=True)
    cell = experiment.cell(configuration)
    passed = len(cell.arm()) * configuration.loop.period_ns * 1e-9
    cell.run(max(LEAST_S, options.force.start_s + AFTER_TOOL_S - passed))
    rows = cell.run(PLAYED_S)
    experiment.require_no_fault(cell)
    names, found = list(configuration.axes), {}
    telemetry = Telemetry.of_rows(prepared.source.path, names, configuration.loop.period_ns, rows, "")
    budgets = budget_of(telemetry, configuration, names, COHERENCE_S)
    for i, (axis, budget) in enumerate(zip(names, budgets, strict=True)):
        own = rows["axis"][:, i]
        before, left = (float(np.sqrt(np.mean(own[f] ** 2))) for f in ("uncompensated_um", "path_error_um"))
        limited = 100.0 * float(np.mean(at_limit(configuration, axis, own["voltage_V"], own["setpoint_um"])))
        found[axis] = {UNCOMPENSATED: before, LEFT: left, LIMITED: limited, BOUND: budget.bound.rms_um}
    return found


def sines(prepared: Prepared) -> list[dict[str, Any]]:
    """Rows of `evaluate`; of a plant with which the paper's PID ends in a fault, those with its own PID alone."""
    configuration, experiment = prepared.configuration, VirtualExperiment(prepared)
    try:
        return table(evaluate(configuration, experiment, tuned=True), configuration)
    except CheckFailed:
        own = table(evaluate(configuration, experiment, own_pid=True), configuration)
        return [row | {"config": TUNED} for row in own if row["config"] == "C"]  # D is C with another PID


def reached(prepared: Prepared) -> dict[str, Reached]:
    """By axis, of a tuned cell that tracks."""
    tracked, other, rows = played(prepared), played(prepared, FASTER), sines(prepared)
    found = {}
    for axis, path in tracked.items():
        own = [row for row in rows if row["axis"] == axis]
        gauge, true = (
            {f"{row['config']} {row['frequency_hz']:g} Hz": row[key] for row in own}
            for key in ("std_error_um", "true_std_error_um")
        )
        path = {**path, MOVED: other[axis][LEFT]}
        found[axis] = {PATH: path, GAUGE: gauge, TRUE: true}
    return found


def real_loop(configuration: Configuration, folder: Path) -> dict[str, Values]:
    """By axis, of `configuration` on the real loop."""
    document = configuration.model_dump(mode="json", exclude_unset=True, by_alias=True) | {"arm_on_start": True}
    file = folder / "commissioned.yaml"
    file.write_text(yaml.safe_dump(document), encoding="utf-8")
    command = [MICROMANIP, "run", file, "--duration", f"{REAL_S:g}", "--socket", folder / "control", "--json"]
    found = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    rows = {UNCOMPENSATED: "uncompensated_rms", "rms": "rms", "greatest": "max"}
    late = {"cycles that came too late": found["overruns"]}
    return {axis: {row: um[key] for row, key in rows.items()} | late for axis, um in found["path_error_um"].items()}


def drawn_plant(seed: int) -> Reached | str:
    """What the plant of `seed` reaches, or why it does not pass."""
    what = drawn(of_axes("factory.yaml", [AXIS]), seed)
    return what if isinstance(what, str) else reached(what)[AXIS]


def rows_of(columns: Mapping[str, Values]) -> list[dict[str, Any]]:
    """Rows of a table: a column for each of `columns`."""
    names = dict.fromkeys(row for values in columns.values() for row in values)
    return [{"": row} | {column: values.get(row) for column, values in columns.items()} for row in names]


def spread(found: Sequence[Values]) -> dict[str, Values]:
    """Columns for median and worst of drawn plants."""
    every = {row: [each[row] for each in found if row in each] for row in dict.fromkeys(r for e in found for r in e)}
    middle, worst = ({row: float(f(v)) for row, v in every.items()} for f in (np.median, max))
    return {"drawn, median": middle, "drawn, worst": worst}


def run(asked: Asked) -> Report:
    """Our axes, the real loop and `count` drawn plants; wrong is a path error below the bound or above the motion."""
    factory = of_axes("factory.yaml", "xyz")
    found = commissioned(factory, factory.configuration)
    if not found.passed:
        return Report(wrong=["config/factory.yaml does not pass: see `micromanip commission`"])
    own = reached(tuned(factory, found.configuration))
    report, plants = Report(), []
    seeds = range(FIRST_PLANT, FIRST_PLANT + asked.count)
    for seed, plant in zip(seeds, each(drawn_plant, seeds, jobs=asked.jobs), strict=True):
        if isinstance(plant, str):
            report.notes.append(f"plant {seed} does not pass: {plant}")
        else:
            plants.append(plant)
        asked.tell(f"plant {seed}: {plant if isinstance(plant, str) else plant[PATH][LEFT]}")
    published = {f"{letter} {hz:g} Hz": um for letter, row in paper.SIGMA_UM.items() for hz, um in row.items()}
    for title in (PATH, GAUGE, TRUE):
        columns = {axis: values[title] for axis, values in own.items()} | spread([plant[title] for plant in plants])
        report.tables[title] = rows_of({"paper": published} | columns if title == GAUGE else columns)
    report.tables[REAL] = rows_of(real_loop(found.configuration, asked.folder))
    free = [plant[PATH][LEFT] for plant in plants if not plant[PATH][LIMITED]]
    passed = f"{len(plants)} of {asked.count} drawn plants pass"
    if free:
        passed += (
            f"; the median of the {len(free)} that never came to an end of their range is {np.median(free):.3f} um"
        )
    report.notes.insert(0, passed)
    for name, values in [*own.items(), *((f"plant {k}", plant) for k, plant in enumerate(plants))]:
        path = values[PATH]
        if not path[BOUND] < path[LEFT] < path[UNCOMPENSATED]:
            report.wrong.append(f"{name}: {path[LEFT]:.3f} um is not between bound and what moves")
    return report
