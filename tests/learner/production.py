"""A cell that makes part after part in virtual time, and learns with the very objects of host and learning process."""

import re
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np

from micromanip.control.learned import RECOGNISED_S
from micromanip.design.learning import learner
from micromanip.design.learning.transfer import Transfer
from micromanip.host.learning.correction import Correction
from micromanip.host.learning.correction import Memories as Rows
from micromanip.learner.gathering import Gathering
from micromanip.learner.memories import Memories
from micromanip.rt.states import BEGIN_PART
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment, with_options
from micromanip.virtual.switched import DRAWN, simulated_driver, switched

SIMULATED = Path(__file__).parents[2] / "config" / "simulated.yaml"
BEGIN_S, AFTER_S = 4.5, 1.0
LOOP_HZ = 10_000
# the joints swing at 7.76 and 8.24 Hz on y and z; the force is there when the part begins
EARLY = ("force: {start_s: 5.0,", "force: {start_s: 2.0,")


def text(seconds, *changes, learning=""):
    # what is followed, and which predictor is believed, hangs on the least difference: two runs could not be subtracted
    found = re.sub(r"range_percent: .*", "range_percent: 0.0", SIMULATED.read_text())
    found = re.sub(r"      steady:\n(?:        .*\n)+", "", found)
    for old, new in (EARLY, *changes):
        assert found.count(old) == 1, old
        found = found.replace(old, new)
    return f"{found}\nlearning: {{folder: learned, seconds: {seconds}{learning}}}\n"


class Production:
    """Of the configuration `text`, in `folder`; memories that lie there are taken over."""

    def __init__(self, folder, text, draws=4):
        self.file = folder / "cell.yaml"
        self.file.write_text(text)
        self.prepared = prepare(self.file)
        self.learning = self.prepared.configuration.learning
        self.axes = list(self.prepared.configuration.axes)
        with patch.object(learner, "Transfer", partial(Transfer, draws=draws)):
            self.memories = Memories(self.prepared.configuration, self.learning, folder / "learned")
        self.said = list(self.memories.read())
        self.table = np.zeros_like(self.prepared.samples)
        self.correction = Correction(self.prepared, self.learning, self.table)
        self.hand_over()

    def hand_over(self):
        """What the learning process shows, to the loop."""
        known = self.memories.known
        if known:
            rows = Rows(
                self.memories.rows(), {name: each.tuning for name, each in known.items()},
                {name: each.generation for name, each in known.items()}, self.memories.tool,
            )  # fmt: skip
            assert rows.problem(self.prepared.configuration) is None
            self.correction.withdraw()
            self.correction.hold(rows)

    def goes_by(self, tool, temperature_C=None):
        """As the learning process does when it hears of tool and temperature; what it says."""
        said = self.memories.move_to(self.memories.conditions(tool, temperature_C))
        if said is not None:
            self.correction.withdraw()
            self.hand_over()
        return said

    def cell(self, seed, faults=()):
        """A fresh one, the same path from the same start; `seed` None: nothing is drawn. TRACKING, before its part."""
        driver = simulated_driver(self.prepared)
        options = self.prepared.wiring.options[driver]
        options = switched(options, DRAWN) if seed is None else options.model_copy(update={"seed": seed})
        if faults:
            options = type(options).model_validate({**options.model_dump(), "faults": tuple(faults)})
        cell = VirtualExperiment(with_options(self.prepared, driver, options), process=True).cell(
            self.prepared.configuration, self.table
        )
        self.put(cell)
        cell.arm()
        return cell

    def put(self, cell):
        cell.parameters[:] = self.correction.added(self.prepared, self.prepared.parameters)

    def part(self, seed, *, learns=True, faults=(), meanwhile=None):
        """Rows of a part, and what was said and learned of it; `meanwhile` is given the cell in the middle of it."""
        cell = self.cell(seed, faults)
        gathering = Gathering(self.learning.seconds, self.memories.search_s, RECOGNISED_S, 1.0 / LOOP_HZ)
        said, made = [], [cell.run(BEGIN_S - int(cell.state[0]["cycle"]) / LOOP_HZ)]
        said += gathering.add(made[-1])
        self.goes_by(gathering.tool)
        self.put(cell)
        wired = self.memories.search_s == 0.0
        seen_s = 0.8 + self.memories.search_s
        made.append(cell.run(seen_s) if wired else cell.run(seen_s, command=BEGIN_PART))
        said += gathering.add(made[-1])
        for part in gathering.recognisable():
            for axis, cycle in self.memories.recognised(part).items():
                self.correction.recognised(axis, cycle)
        self.put(cell)
        half_s = 0.5 * self.learning.seconds - seen_s
        made.append(cell.run(half_s))
        made += [] if meanwhile is None else meanwhile(cell)
        rest_s = self.learning.seconds + AFTER_S - seen_s - half_s
        made.append(cell.run(rest_s))
        for rows in made[2:]:
            said += gathering.add(rows)
        learned = {}
        if learns:
            for part in gathering.whole():
                learned |= dict(self.memories.learn(part, lambda: None))
            self.hand_over()
        return np.concatenate(made), said, learned, cell

    def repeats_um(self, *, from_s=0.0, faults=()):
        """True path error (rms) of each axis in a part without anything that is drawn, from `from_s` of it on."""
        rows, _, _, cell = self.part(None, learns=False, faults=faults)
        assert not cell.faults()
        since = rows["cycle"] - round(BEGIN_S * LOOP_HZ)
        within = rows["axis"]["path_error_um"][(since > from_s * LOOP_HZ) & (since <= self.learning.seconds * LOOP_HZ)]
        return dict(zip(self.axes, np.sqrt(np.mean(within**2, axis=0)), strict=True))
