"""Commission config/factory.yaml and put what was found into the tuned configurations.

All describe the same cell, and reach it in the loop's own cycle. What is written by hand beside it, limits, soft start
and devices, stays.
"""

import datetime
import re
from importlib.metadata import version

from micromanip.design.commission.cell import CommissionedCell, commission_cell
from micromanip.design.commission.closing import Options
from micromanip.settings.check import prepare
from micromanip.settings.schema.axis import Commissioned
from micromanip.settings.schema.reference import Tracker
from micromanip.settings.tuning_hash import tuning_hash
from micromanip.settings.write import edited, node, with_tuning, write_atomically, written
from micromanip.virtual.experiment import VirtualExperiment

from .report import ROOT, Asked, Report

CONFIG = ROOT / "config"
TOOTH_HZ = 200.0
NAMES = ("simulated.yaml", "ethercat.yaml", "udp.yaml")
HEADER = """\
# The simulated cell, tuned: three axes hold the spindle on its path while the robot deviates and the
# tool cuts. Physical units, named by the keys; every key is explained in docs/configuration.md.
# The tuning of the axes (inner, hysteresis, hysteresis_affine, outer, actuator) and what the predictor knows of the
# path deviation (reference) are what `make campaign NAME=tune` made of config/factory.yaml: `micromanip commission`,
# all axes, tooth frequency {tooth:g} Hz, seed {seed}, version {version}, {date}. It passes `analyse margins`.
# The rest is written by hand.
"""


def tuned(asked: Asked) -> CommissionedCell:
    """The factory's cell, commissioned."""
    factory = prepare(CONFIG / "factory.yaml")
    configuration = factory.configuration
    experiment, running = VirtualExperiment(factory), VirtualExperiment(factory, process=True)
    axes, options = list(configuration.axes), Options(tooth_Hz=TOOTH_HZ)
    return commission_cell(configuration, experiment, axes, asked.tell, options, asked.seed, running)


def missed(found: CommissionedCell) -> list[str]:
    """What keeps it from being written."""
    criteria = [f"{c.axis}: {c.name}: {c.value}" for story in found.evidence for c in story.criteria if not c.passed]
    obstacle = None if found.production is None else found.production.obstacle
    return criteria if obstacle is None else [*criteria, obstacle]


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
    today, found = datetime.datetime.now(datetime.UTC).date().isoformat(), tuned(asked)
    tracker = found.configuration.reference
    if not found.passed or not isinstance(tracker, Tracker):
        return Report(notes=["Nothing was written."], wrong=missed(found))
    texts = {name: text_of(name, found, tracker, today) for name in NAMES}
    header = HEADER.format(tooth=TOOTH_HZ, seed=asked.seed, version=version("micromanip"), date=today)
    texts["simulated.yaml"] = re.sub(r"\A(#.*\n)*", lambda _: header, texts["simulated.yaml"])
    for name, text in texts.items():
        write_atomically(CONFIG / name, text)
    return Report(notes=[f"Written: {', '.join(texts)}."])
