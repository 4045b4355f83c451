"""Commission config/factory.yaml and put what was found into the tuned configurations.

All describe the same cell, and reach it in the loop's own cycle. What is written by hand beside it, limits, soft start
and devices, stays.
"""

import datetime
import re
from collections.abc import Callable
from functools import partial

from micromanip.design.analyse.budget.recorded import budget_of_rows
from micromanip.design.commission.cell import CommissionedCell, commission_cell
from micromanip.design.commission.closing import Options
from micromanip.settings.check import Prepared, prepare
from micromanip.settings.schema.axis import Commissioned
from micromanip.settings.schema.reference import Tracker
from micromanip.settings.tuning_hash import tuning_hash
from micromanip.settings.write import edited, node, with_tuning, write_atomically, written
from micromanip.virtual.experiment import VirtualExperiment, with_options

from .report import CONFIG, Asked, Report

TOOTH_HZ = 200.0
NAMES = ("simulated.yaml", "ethercat.yaml", "udp.yaml")


def commissioned(
    cell: Prepared, say: Callable[[str], None], options: Options, seed: int = 1, trial_seed: int | None = None
) -> CommissionedCell:
    """All axes of a simulated cell; the process goes on where it rests and where it is tried, on noise of its own."""
    running = cell
    if trial_seed is not None:
        running = with_options(cell, "cell", cell.wiring.options["cell"].model_copy(update={"seed": trial_seed}))
    return commission_cell(
        cell.configuration,
        VirtualExperiment(cell),
        list(cell.configuration.axes),
        say,
        options,
        seed,
        VirtualExperiment(running, process=True),
        budgeted=partial(budget_of_rows, cell.source.path),
    )


def missed(found: CommissionedCell) -> list[str]:
    """What keeps it from being written."""
    if found.stopped is not None:
        return [str(found.stopped)]
    criteria = [f"{c.axis}: {c.name}: {c.value}" for story in found.evidence for c in story.criteria if not c.passed]
    production = found.production
    why = (production.obstacle, production.problem, production.unbudgeted) if production else ()
    return [*criteria, *filter(None, why)]


def text_of(name: str, found: CommissionedCell, tracker: Tracker, today: str) -> str:
    """The configuration `name` with the tuning of its axes and its tracker."""
    axes = {}
    for axis_name, axis in found.configuration.axes.items():
        # what of the coupling was found and is not undone says nothing to who takes an axis away
        coupling = axis.coupling if axis.coupling is not None and axis.coupling.decouple else None
        running = axis.model_copy(update={"mode": "stage", "coupling": coupling})
        note = Commissioned(hash=tuning_hash(running), report="report.html", date=today)
        axes[axis_name] = running.model_copy(update={"commissioned": note})
    known = node(written(tracker, exclude_defaults=True))
    text = with_tuning((CONFIG / name).read_text(encoding="utf-8"), axes)
    text = edited(text, lambda document: document["reference"].update(known))
    return re.sub(r"(?<!\n)\naxes:", "\n\naxes:", text)  # a line that new keys before it take away


def run(asked: Asked) -> Report:
    """In virtual time; where a criterion is missed, nothing is written."""
    today, options = datetime.datetime.now(datetime.UTC).date().isoformat(), Options(tooth_Hz=TOOTH_HZ)
    found = commissioned(prepare(CONFIG / "factory.yaml"), asked.tell, options, asked.seed)
    tracker = found.configuration.reference
    if not found.passed or not isinstance(tracker, Tracker):
        return Report(notes=["Nothing was written."], wrong=missed(found))
    texts = {name: text_of(name, found, tracker, today) for name in NAMES}
    for name, text in texts.items():
        write_atomically(CONFIG / name, text)
    return Report(notes=[f"Written: {', '.join(texts)}."])
