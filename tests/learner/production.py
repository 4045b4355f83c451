"""A cell that makes part after part in virtual time, and learns with the very objects of host and learning process."""

import re
from functools import partial
from unittest.mock import patch

import numpy as np

from campaigns.report import CONFIG
from micromanip.design.learning import law
from micromanip.host.learning.handover import Handover, Memories
from micromanip.learner.memory_store import MemoryStore
from micromanip.learner.part_collector import PartCollector
from micromanip.rt.states import BEGIN_PART, NO_COMMAND
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment, with_options

SIMULATED = CONFIG / "simulated.yaml"
BEGIN_S, AFTER_S = 4.5, 1.0
LOOP_HZ = 10_000
# the joints swing at 7.76 and 8.24 Hz on y and z; the force is there when the part begins
EARLY = ("force: {start_s: 5.0,", "force: {start_s: 2.0,")
DRAWN = ("strain_noise_nm", "strain_hum_nm", "stage_noise_nm", "amplifier_noise_mV")
WEAK = 0.1
"""What is left of a sensor's noise: one that always reads the same is a fault."""
LINES = ("    force: {start_s: 2.0,", "    lines: {}\n    force: {start_s: 2.6,")


def text(seconds, *changes):
    # what is followed, and which predictor is believed, hangs on the least difference: two runs could not be subtracted
    found = re.sub(r"range_percent: .*", "range_percent: 0.0", SIMULATED.read_text())
    found = re.sub(r"      steady:\n(?:        .*\n)+", "", found)
    for old, new in (EARLY, *changes):
        assert found.count(old) == 1, old
        found = found.replace(old, new)
    return f"{found}\nlearning: {{folder: learned, seconds: {seconds}}}\n"


def with_line(seconds, signal, channel):
    """With a line of the machine for `signal`; scheduled faults of the `channel` lead it."""
    wired = ("  true_strain_x:", f"  {signal}: {{driver: cell, channel: {channel}}}\n  true_strain_x:")
    return text(seconds, LINES, wired) + "switches: {amplifier_enable: {driver: cell}}\n"


def quiet(options):
    """Options of the cell without what is drawn."""

    def weak(plant):
        return plant.model_copy(update={name: WEAK * getattr(plant, name) for name in DRAWN})

    return options.model_copy(
        update={
            "tracker": options.tracker.model_copy(update={"noise_um": 0.0}),
            "force": options.force.model_copy(update={"noise_N": 0.0}),
            "plant": weak(options.plant),
            "variation": {axis: weak(plant) for axis, plant in options.variation.items()},
        }
    )


class Production:
    """Of the configuration `text`, in `folder`; memories that lie there are taken over."""

    def __init__(self, folder, text, draws=4):
        self.file = folder / "cell.yaml"
        self.file.write_text(text)
        self.prepared = prepare(self.file)
        self.learning = self.prepared.configuration.learning
        self.axes = list(self.prepared.configuration.axes)
        with patch.object(law, "Transfer", partial(law.Transfer, draws=draws)):
            self.store = MemoryStore(self.prepared.configuration, folder / "learned")
        self.said = list(self.store.read())
        self.tool = 0
        self.table = np.zeros_like(self.prepared.samples)
        self.handover = Handover(self.learning, self.table)
        self.hand_over()

    def hand_over(self):
        """What the learning process shows, to the loop."""
        known = self.store.of_tool(self.tool)
        self.handover._withdraw()
        if known:
            self.handover.next = Memories(
                self.store.rows(self.tool), {name: each.tuning for name, each in known.items()},
                {name: each.generation for name, each in known.items()}, self.tool,
            )  # fmt: skip
            assert self.handover.next.problem(self.learning, self.axes) is None
            self.handover._hold_next()

    def cell(self, seed, faults=()):
        """A fresh one, the same path from the same start; `seed` None: nothing is drawn. TRACKING, before its part."""
        options = self.prepared.wiring.options["cell"]
        options = quiet(options) if seed is None else options.model_copy(update={"seed": seed})
        if faults:
            options = type(options).model_validate({**options.model_dump(), "faults": tuple(faults)})
        cell = VirtualExperiment(with_options(self.prepared, "cell", options), process=True).cell(
            self.prepared.configuration, self.table
        )
        self.put(cell)
        cell.arm()
        return cell

    def put(self, cell):
        cell.parameters[:] = self.handover.added(self.prepared, self.prepared.parameters)

    def part(self, seed, *, learns=True, faults=(), meanwhile=None):
        """Rows of a part, what was said of it and what became of it; `meanwhile` gets the cell in the middle of it."""
        cell, found = self.cell(seed, faults), []
        collector = PartCollector(self.learning.seconds, 1.0 / LOOP_HZ)
        made = [cell.run(BEGIN_S - int(cell.state[0]["cycle"]) / LOOP_HZ)]
        found += collector.add(made[0])
        if collector.tool != self.tool:
            self.tool = collector.tool
            self.hand_over()
            self.put(cell)
        begin = NO_COMMAND if "part" in self.prepared.configuration.signals else BEGIN_PART
        made.append(cell.run(0.5 * self.learning.seconds, command=begin))
        made.append(cell.run(0.2) if meanwhile is None else meanwhile(cell))
        made.append(cell.run(0.5 * self.learning.seconds + AFTER_S))
        for rows in made[1:]:
            found += collector.add(rows)
        said, learned = [each for each in found if isinstance(each, str)], {}
        for part in found if learns else ():
            if not isinstance(part, str):
                learned |= dict(self.store.learn(part, lambda: None))
                self.hand_over()
        return np.concatenate(made), said, learned, cell

    def repeats_um(self, faults=()):
        """True path error (rms) of each axis in a part without anything that is drawn."""
        rows, _, _, cell = self.part(None, learns=False, faults=faults)
        assert not cell.faults()
        since = rows["cycle"] - round(BEGIN_S * LOOP_HZ)
        within = rows["axis"]["path_error_um"][(since > 0) & (since <= self.learning.seconds * LOOP_HZ)]
        return dict(zip(self.axes, np.sqrt(np.mean(within**2, axis=0)), strict=True))
