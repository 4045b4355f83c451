"""A cell whose path goes round and round, in virtual time, with the learning process' and the host's own objects."""

import asyncio
from functools import partial
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np

from micromanip.design.learning import learner
from micromanip.design.learning.transfer import Transfer
from micromanip.host.learning.keeper import LearningKeeper
from micromanip.host.shared_memory import Segments
from micromanip.learner import process
from micromanip.rt import mailbox as w
from micromanip.rt.states import BEGIN_PART
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment, with_options
from micromanip.virtual.switched import DRAWN, simulated_driver, switched

from .production import BEGIN_S, LOOP_HZ, text

PERIOD_S, ROWS_PER_S = 3.0, 500
STEP_S = 0.1
JOINTS = {"x": 24, "y": 23, "z": 25}
"""Swings of a joint in a period: 8, 7.67 and 8.33 Hz, where the predictor believes 8."""


def write_path(file, seconds=60.0, period_s=PERIOD_S):
    """A robot that goes the same way in every period, rms some 80 um; the file."""
    time_s = np.arange(round(seconds * ROWS_PER_S)) / ROWS_PER_S
    turn = 2 * np.pi * time_s / period_s
    columns = [time_s]
    for k, swings in enumerate(JOINTS.values()):
        columns.append(100.0 * np.sin(turn + k) + 30.0 * np.sin(3 * turn) + 25.0 * np.sin(swings * turn + k))
    names = ",".join(["t_s", *(f"deviation_{axis}_um" for axis in JOINTS)])
    np.savetxt(file, np.column_stack(columns), delimiter=",", header=names, comments="")
    return file


def played(path):
    """What makes the simulated robot go as a file says."""
    return "    tracker: {", f"    deviation: {{file: {path}, start_s: 0.0}}\n    tracker: {{"


class Turning:
    """One run of the cell, from its part's beginning on; `seed` None: nothing is drawn."""

    def __init__(self, folder, seed, *, path=None, learns=True):
        self.path = path or write_path(folder / "path.csv")
        self.file = folder / "cell.yaml"
        self.file.write_text(text(PERIOD_S, played(self.path), learning=", repeats: true"))
        self.prepared = prepare(self.file)
        self.segments = Segments.create(64, self.prepared.samples)
        self.added = None
        self.said, self.noted, self.told = [], [], []
        self.keeper = LearningKeeper(self, self.prepared.configuration.learning, self.put, self.note, self.said.append)
        self.keeper._child = SimpleNamespace(tell=self.told.append, kill=lambda: None)
        self.cell = self._cell(seed)
        self.words = np.zeros(w.WORDS, np.int64)
        self.cell.arm()
        rows = self.cell.run(BEGIN_S - int(self.cell.state[0]["cycle"]) / LOOP_HZ)
        self.rows, self._unread = [rows], [rows]
        self.learns = learns
        self._process = self._learning(folder) if learns else None

    def _cell(self, seed):
        driver = simulated_driver(self.prepared)
        options = self.prepared.wiring.options[driver]
        options = switched(options, DRAWN) if seed is None else options.model_copy(update={"seed": seed})
        cell = VirtualExperiment(with_options(self.prepared, driver, options), process=True).cell(
            self.prepared.configuration, self.segments.sample_table()
        )
        cell.parameters[:] = self.added(self.prepared, self.prepared.parameters)
        return cell

    def _learning(self, folder):
        source = self.prepared.source
        orders = {
            "path": str(source.path), "configuration": source.text, "folder": str(folder / "learned"),
            "rows": self.keeper._room.descriptor, "temperature_C": None,
        }  # fmt: skip
        with patch.object(learner, "Transfer", partial(Transfer, draws=4)), self._heard():
            made = process.Learning(orders, self)
            made.read()
        return made

    def read(self):
        """As the ring's reader."""
        return self._unread.pop(0) if self._unread else np.zeros(0)

    def _heard(self):
        """What the process tells comes at once."""
        return patch.object(process, "tell", lambda **said: asyncio.run(self.keeper._hear(said)))

    async def put(self, before):
        before()
        self.cell.parameters[:] = self.added(self.prepared, self.prepared.parameters)

    async def note(self, changes):
        self.noted.extend(changes)

    @property
    def buffers(self):
        return SimpleNamespace(in_force=self.cell.parameters[0], is_unconfirmed=False)

    def run(self, seconds, command=None):
        """So long, with the host and the process at work."""
        for k in range(round(seconds / STEP_S)):
            rows = self.cell.run(STEP_S, command=command) if k == 0 and command else self.cell.run(STEP_S)
            self.rows.append(rows)
            self._unread.append(rows)
            if self._process is None:
                continue
            with self._heard():
                for order in self.told:
                    if "taken" in order:
                        self._process.taken()
                self.told.clear()
                self._process.follow()
            state = self.cell.state[0]
            asyncio.run(self.keeper._playing.put_in_force(state, state["axis"]["learned"][: len(JOINTS)]))
        return self

    def begin(self):
        """A person says that the part begins."""
        return self.run(STEP_S, BEGIN_PART)

    def periods_um(self, column="path_error_um"):
        """Rms (periods, axes) of `column`, from the part's beginning on."""
        rows = np.concatenate(self.rows)
        count = round(PERIOD_S * LOOP_HZ)
        values = rows["axis"][column][rows["cycle"] > round(BEGIN_S * LOOP_HZ)][:, : len(JOINTS)]
        whole = values[: len(values) // count * count].reshape(-1, count, len(JOINTS))
        return np.sqrt(np.mean(whole**2, axis=1))
