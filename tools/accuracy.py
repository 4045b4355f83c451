"""What the cell reaches, beside the paper and beside the bound: `make accuracy` writes docs/accuracy.md.

Virtual time throughout, the truth of the simulation, seeds fixed below. Each cell is commissioned from factory values,
and what was found is played with the process, on other noise than it was found with. How many plants are drawn is a
matter of CPU time; which ones is not.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from micromanip.design import paper
from micromanip.design.budget.configured import bound_of, cell_of
from micromanip.design.commission.cell import CommissionedCell, commission_cell
from micromanip.design.commission.knobs import Knobs
from micromanip.design.evaluation import TUNED, evaluate, table
from micromanip.design.experiment import with_axis
from micromanip.errors import CheckFailed
from micromanip.settings.check import Prepared, prepare
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.model import Configuration
from micromanip.settings.write import write_atomically
from micromanip.virtual.experiment import VirtualExperiment
from micromanip.virtual.switched import simulated_driver
from tools.robustness.campaign import narrowed
from tools.robustness.family import drawn_cell

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "accuracy.md"
AXIS, SEED, PLAYED_SEED, FIRST_PLANT, SLEW_UM_PER_MS = "x", 1, 7, 200, 10.0
"""Axis of the drawn plants; seeds of the excitations, of the noise that is played, and of the first plant; the slew
limit of their set-point, as in the cell of `make robustness`."""
MINUTES, PLAYED_S, AFTER_TOOL_S, LEAST_S, COHERENCE_S = 10.0, 10.0, 1.0, 2.0, 1.0
"""CPU time for drawn plants; virtual time that counts, after the tool's entry and after tracking began; the bound's."""
UNCOMPENSATED, BEFORE, NOW, BOUND, LIMITED = (
    "uncompensated",
    "`config/simulated.yaml`",
    "as `commission` leaves it",
    "causal bound",
    "time at an end of the actuator's range, %",
)
_ORDER = (UNCOMPENSATED, BEFORE, NOW, BOUND, LIMITED)
_PAGE = f"""\
# Accuracy: what the cell reaches

Made by `make accuracy` ([`accuracy.py`](../tools/accuracy.py)), in virtual time, by the simulation's truth.
The axes {{axes}} are those of `config/factory.yaml`, commissioned with the seed {SEED} and played with the noise of
seed {PLAYED_SEED}. The drawn plants are the seeds {FIRST_PLANT} to {{last}} of the family of `make robustness`
([page](commissioning.md#how-far-to-trust-it)), {{drawn}} in all, each commissioned from factory values. {{passed}}
passed and are in the tables; those that did not stand at the end, with the reason.

## Path error

Rms, um, over {PLAYED_S:g} s of tracking while the tool cuts. The paper closes no outer loop and has no path error.

{{path}}

The bound is that of [the error budget](budget.md#the-bound): no causal controller with these sensors goes below it,
where phases are known for {COHERENCE_S:g} s. It asks for no margins, and a loop that bears another plant is above it;
nor does it count the zeros that a second flexure mode puts outside the unit circle, which
[bound most drawn plants](budget.md#the-forces-share-what-bounds-it).
A drawn actuator may be too weak for the common path: at an end of its voltage or set-point nothing is corrected.
Of the {{free}} that never came to one the median is {{free_um}} um.

## Sines on the gauge

The paper's experiment (its Table 1), 70 um + 30 um sin, without machining: sigma of set-point less position, um, by
configuration and frequency in Hz. {{letters}}, D: the tanh inverse with the axis' own PID.

With the paper's one PID {{faulty}} of the drawn plants end in a limit cycle: in A, B and C they are not counted.

Measured by the gauge, whose own noise is .055 um; the paper's figures are of its own stage:

{{gauge}}

True position:

{{true_gauge}}
"""
_AS_TUNED = "C"
"""Of the paper's configurations: what `TUNED` is with another PID."""
Values = dict[str, float]
"""By row of a table."""


@dataclass(frozen=True)
class Reached:
    """Of one axis: rms of the path error, and sigma of the gauge on sines (measured and true), um, by row."""

    path: Values
    gauge: Values
    true_gauge: Values


def changed(name: str, axes: Sequence[str]) -> Prepared:
    """A configuration of ours with `axes` alone, which knows the truth and cuts."""
    document = yaml.safe_load((ROOT / "config" / name).read_text(encoding="utf-8"))
    known = ("strain", "stage", "deviation", "true_strain", "true_stage", "path_error", "uncompensated")
    document["signals"] = {
        f"{kind}_{axis}": document["signals"].get(f"{kind}_{axis}", {"driver": "cell"})
        for kind in known
        for axis in axes
    }
    for section in ("outputs", "axes"):
        document[section] = {k: v for k, v in document[section].items() if k.removeprefix("voltage_") in axes}
    cell = document["drivers"]["cell"]
    cell["axes"], cell["variation"] = list(axes), {k: v for k, v in cell["variation"].items() if k in axes}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / name
        file.write_text(yaml.safe_dump(document), encoding="utf-8")
        return prepare(file)


def tuned(prepared: Prepared, configuration: Configuration) -> Prepared:
    """The same cell with another configuration."""
    return replace(prepared, configuration=configuration, parameters=compile_cell(configuration, prepared.wiring))


def commissioned(prepared: Prepared, configuration: Configuration) -> CommissionedCell:
    """`configuration` commissioned on the cell of `prepared`, the process going on where it rests."""
    experiment, running = VirtualExperiment(prepared), VirtualExperiment(prepared, process=True)
    return commission_cell(configuration, experiment, list(configuration.axes), lambda _: None, Knobs(), SEED, running)


def played(prepared: Prepared) -> dict[str, Values]:
    """By axis, of what `prepared` tracks: rms (um) of the path error, uncompensated too; how much is out of reach."""
    name, configuration = simulated_driver(prepared), prepared.configuration
    driver: Any = prepared.wiring.drivers[name]
    options = driver.options.model_copy(update={"seed": PLAYED_SEED})
    drivers = {**prepared.wiring.drivers, name: type(driver)(options, configuration.loop.period_ns)}
    experiment = VirtualExperiment(replace(prepared, wiring=replace(prepared.wiring, drivers=drivers)), process=True)
    cell = experiment.cell(configuration)
    passed = len(cell.arm()) * configuration.loop.period_ns * 1e-9
    cell.run(max(LEAST_S, options.force.start_s + AFTER_TOOL_S - passed))
    rows = cell.run(PLAYED_S)["axis"]
    experiment.require_no_fault(cell)
    found = {}
    for i, (axis, settings) in enumerate(configuration.axes.items()):
        ends = (
            ("voltage_V", configuration.outputs[f"voltage_{axis}"].range_V),
            ("setpoint_um", settings.setpoint.range_um),
        )
        limited = np.any([(rows[name][:, i] <= low) | (rows[name][:, i] >= high) for name, (low, high) in ends], axis=0)
        moved, left = (float(np.sqrt(np.mean(rows[f][:, i] ** 2))) for f in ("uncompensated_um", "path_error_um"))
        found[axis] = {UNCOMPENSATED: moved, NOW: left, LIMITED: 100.0 * float(np.mean(limited))}
    return found


def sines(prepared: Prepared) -> list[dict[str, Any]]:
    """Rows of `evaluate`; of a plant with which the paper's PID ends in a fault, those with its own PID alone."""
    configuration, experiment = prepared.configuration, VirtualExperiment(prepared)
    try:
        return table(evaluate(configuration, experiment, tuned=True), configuration)
    except CheckFailed:
        own = table(evaluate(configuration, experiment, own_pid=True), configuration)
        return [row | {"config": TUNED} for row in own if row["config"] == _AS_TUNED]


def reached(prepared: Prepared) -> dict[str, Reached]:
    """By axis, of a tuned cell that tracks."""
    tracked = played(prepared)
    rows, found = sines(prepared), {}
    for axis in prepared.configuration.axes:
        cell = cell_of(prepared, axis)
        assert cell.known is not None
        bound = bound_of(cell, cell.known, COHERENCE_S).rms_um
        gauge, true = (
            {f"{row['config']} {row['frequency_hz']:g}": row[key] for row in rows if row["axis"] == axis}
            for key in ("std_error_um", "true_std_error_um")
        )
        found[axis] = Reached(
            {row: (tracked[axis] | {BOUND: bound})[row] for row in _ORDER if row != BEFORE}, gauge, true
        )
    return found


def drawn(prepared: Prepared, seed: int) -> Reached | str:
    """What the plant of `seed` reaches once it is commissioned; a reason where it isn't."""
    cell, _, reach = drawn_cell(prepared, AXIS, seed)
    narrow = narrowed(prepared.configuration, reach)
    setpoint = narrow.axes[AXIS].setpoint.model_copy(update={"slew_um_per_ms": SLEW_UM_PER_MS})
    found = commissioned(cell, with_axis(narrow, AXIS, setpoint=setpoint))
    if found.stopped is not None:
        return str(found.stopped)
    missed = [f"{each.name}: {each.value}" for story in found.evidence for each in story.criteria if not each.passed]
    return "; ".join(missed) if missed else reached(tuned(cell, found.configuration))[AXIS]


def drawn_plants(minutes: float) -> Iterator[dict[int, Reached | str]]:
    """By seed, one more each time, as many as `minutes` of CPU time allow."""
    prepared, began = changed("factory.yaml", [AXIS]), time.process_time()
    found: dict[int, Reached | str] = {}
    while time.process_time() - began < 60.0 * minutes:
        seed = FIRST_PLANT + len(found)
        what = found[seed] = drawn(prepared, seed)
        told = what if isinstance(what, str) else f"path error {what.path[NOW]:.3f} um"
        sys.stderr.write(f"plant {seed}: {told}\n")
        yield found


def own_axes() -> dict[str, Reached]:
    """The axes of the common cell: as config/simulated.yaml has them, and commissioned anew."""
    factory, before = changed("factory.yaml", "xyz"), changed("simulated.yaml", "xyz")
    found = commissioned(factory, factory.configuration)
    if not found.passed:
        raise SystemExit("config/factory.yaml does not pass: see `micromanip commission`; nothing was written")
    now, as_it_stands = reached(tuned(factory, found.configuration)), played(before)
    return {
        axis: replace(each, path={row: (each.path | {BEFORE: as_it_stands[axis][NOW]})[row] for row in _ORDER})
        for axis, each in now.items()
    }


def lines(rows: Iterable[str], columns: Mapping[str, Mapping[str, float]], digits: int = 3) -> list[str]:
    """A table in Markdown: a line for each row, a column for each of `columns`; what isn't there is left open."""
    head = ["| |", "|---|"]
    body = {row: f"| {row} |" for row in rows}
    for name, values in columns.items():
        head = [head[0] + f" {name} |", head[1] + "---|"]
        for row in body:
            body[row] += f" {values[row]:.{digits}f} |" if row in values else " |"
    return [*head, *body.values()]


def spread(found: Sequence[Values]) -> tuple[Values, Values]:
    """Median and worst by row."""
    rows = dict.fromkeys(row for each in found for row in each)
    every = {row: [each[row] for each in found if row in each] for row in rows}
    return {row: float(np.median(v)) for row, v in every.items()}, {row: max(v) for row, v in every.items()}


def page(own: Mapping[str, Reached], plants: Mapping[int, Reached | str]) -> str:
    """The page."""
    good = [each for each in plants.values() if isinstance(each, Reached)]
    refused = {seed: why for seed, why in plants.items() if isinstance(why, str)}

    free = [each.path[NOW] for each in good if not each.path.get(LIMITED)]

    def columns(kind: str) -> dict[str, Values]:
        found = {axis: getattr(each, kind) for axis, each in own.items()}
        middle, worst = spread([getattr(each, kind) for each in good])
        return found | {"drawn, median": middle, "drawn, worst": worst}

    first = next(iter(own.values()))
    papers = {f"{letter} {hertz:g}": um for letter, row in paper.SIGMA_UM.items() for hertz, um in row.items()}
    text = _PAGE.format(
        axes=", ".join(own),
        drawn=len(plants),
        passed=len(good),
        faulty=sum(not any(row.startswith(_AS_TUNED) for row in each.gauge) for each in good),
        last=FIRST_PLANT + len(plants) - 1,
        free=len(free),
        free_um=f"{np.median(free):.3f}" if free else "-",
        path="\n".join(lines(first.path, columns("path"))),
        letters=", ".join(f"{letter}: {label}" for letter, label in paper.LABELS.items()),
        gauge="\n".join(lines(first.gauge, {"paper": papers, **columns("gauge")})),
        true_gauge="\n".join(lines(first.true_gauge, columns("true_gauge"))),
    )
    if refused:
        text += "\n".join(["", "## Plants that did not pass", "", *(f"- {k}: {why}" for k, why in refused.items()), ""])
    return text


def main() -> int:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=MINUTES, help="CPU time for drawn plants.")
    given = parser.parse_args()
    own = own_axes()
    for plants in drawn_plants(given.minutes):  # whoever ends it has a page of those that there are
        write_atomically(PAGE, page(own, plants))
    return 0


if __name__ == "__main__":
    sys.exit(main())
