"""Experiments in real time: a daemon runs variants of the configuration, one after another; rows are read back."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.design.experiment import Ended
from micromanip.errors import CheckFailed
from micromanip.recordings import open_telemetry
from micromanip.rt.arming import planned_cycles
from micromanip.rt.records import CELL_STATE, MAX_AXES
from micromanip.rt.states import TRACKING
from micromanip.settings.change import needs
from micromanip.settings.check import Prepared
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.key import RESTART
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import FeedbackPath, feedback_path
from micromanip.virtual.own_time import at_own_time

from .live import LiveLine
from .live_daemon import Order

_RESUMED_S = 3600.0
"""What a run left that was broken off longer ago is of another day's stage."""
_ROOM_S = 20.0
"""What a daemon has room for of samples to play; a longer experiment has one of its own."""


class LiveCell:
    """The cell, and the recordings of its experiments in `folder`, in their order: those that are there are not made.

    One daemon serves them, which stands in READY in between; another where something differs that takes a new start.
    """

    def __init__(self, prepared: Prepared, socket_path: Path, folder: Path) -> None:
        if folder.is_dir() and time.time() - folder.stat().st_mtime > _RESUMED_S:
            shutil.rmtree(folder)
        folder.mkdir(exist_ok=True)
        self.prepared, self._socket_path, self._folder = prepared, socket_path, folder
        self._daemon: _Daemon | None = None
        self.asked, self.left = 0, len(list(folder.glob("*.mcap")))
        """How many were asked for, and how many a run that was broken off has left."""

    def play(
        self, variant: Configuration, seconds: float, samples: NDArray[np.float64], *, process: bool = False
    ) -> NDArray[Any]:
        """Rows, one per cycle, of `seconds` of TRACKING with `samples` played; the loop arms and stops softly.

        Each sample stands at its own time, see `at_own_time`. `process` keeps the machining force of a simulation.
        Raises Ended where a fault ended it, else CheckFailed where cycles are missing.
        """
        self.asked += 1
        asked = (self.prepared.source.hash, variant.model_dump_json(), f"{seconds} {process}")
        name = hashlib.sha256(b"|".join((*map(str.encode, asked), samples.tobytes()))).hexdigest()[:16]
        file, made = self._folder / f"{self.asked:03}-{name}.mcap", self._folder / "unfinished"
        if not file.exists():
            made.unlink(missing_ok=True)
            self._make(Order(variant, samples, seconds, made), process=process)
            made.replace(file)
        rows = _rows(file)
        rows = rows[rows["state"] == TRACKING][: round(seconds * variant.loop.rate_hz)]
        wanted = np.arange(rows["cycle"][0], rows["cycle"][-1] + 1) if len(rows) else np.arange(0)
        if len(wanted) < 0.99 * seconds * variant.loop.rate_hz:
            raise CheckFailed("the experiment was cut short")
        # a cycle that an overrun skipped held its output: its row is that of the cycle before
        rows = rows[np.searchsorted(rows["cycle"], wanted, side="right") - 1]
        return at_own_time(rows, variant, self.prepared.wiring)

    def _make(self, order: Order, *, process: bool) -> None:
        if self._daemon is None or not self._daemon.serves(order, process=process):
            self.end()
            self._daemon = _Daemon(self.prepared, process, self._socket_path, order)
        else:
            self._daemon.pipe.send(order)
        arming = planned_cycles(compile_cell(order.configuration, self.prepared.wiring)[0], np.zeros(1, CELL_STATE)[0])
        faults = self._daemon.answer(int(arming) * order.configuration.loop.period_ns * 1e-9 + order.seconds)
        if faults:
            said = f"the experiment was ended by a fault: {faults[0]}"
            raise Ended(said, _rows(order.file)) if order.file.exists() else CheckFailed(said)

    def end(self) -> None:
        """Let the outputs be led to rest, and wait for that."""
        if self._daemon is not None:
            self._daemon.process.terminate()
            self._daemon.answer()
            self._daemon.process.wait()
            self._daemon = None


def _rows(file: Path) -> NDArray[Any]:
    return np.concatenate(list(open_telemetry(file).rows()))


class _Daemon:
    """The process that serves a cell (`live_daemon.py`), begun with its first order."""

    def __init__(self, prepared: Prepared, force: bool, socket_path: Path, first: Order) -> None:
        self._force, self._configuration, self._seen_s, self._over = force, first.configuration, 0.0, False
        self._room = max(round(_ROOM_S * first.configuration.loop.rate_hz), len(first.samples))
        self.pipe, theirs = Pipe()
        with theirs:  # in a session of its own: Ctrl-C is for this process, which then ends it
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "micromanip.cli.live_daemon", str(theirs.fileno())],
                pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True,
            )  # fmt: skip
        self.pipe.send((prepared.source, force, socket_path, self._room, first))

    def serves(self, order: Order, *, process: bool) -> bool:
        """Whether it lives, and an order takes no new start."""
        fits = process == self._force and len(order.samples) <= self._room and self.process.poll() is None
        return fits and not self._over and RESTART not in needs(self._configuration, order.configuration).values()

    def answer(self, seconds: float | None = None) -> list[str]:
        """The faults that ended what was ordered, which takes so many seconds, or that there were at its end."""
        with LiveLine() as line:
            line.planned_s = None if seconds is None else self._seen_s + seconds
            while not self._over:
                try:
                    kind, what = self.pipe.recv()
                except (EOFError, ConnectionError):
                    self._over = True
                    break
                if kind == "say":
                    line.say(what)
                elif kind == "show":
                    self._seen_s = what["cycles"] * what["period_ns"] * 1e-9
                    line.show(what)
                else:
                    self._over = kind == "raise" or bool(what) or seconds is None
                    if kind == "raise":
                        raise what
                    return list(what)
        if seconds is not None:
            raise CheckFailed("the daemon of the experiment has ended")
        return []


@dataclass(frozen=True)
class LiveExperiment:
    """Experiments of a live cell, with the machining force of a simulation or without; see `design.experiment`."""

    cell: LiveCell
    process: bool = False

    def __call__(
        self,
        configuration: Configuration,
        seconds: float,
        samples: NDArray[np.float64] | None = None,
        every: int = 1,
    ) -> NDArray[Any]:
        """Rows, one in `every` cycles, of the `seconds` after tracking began."""
        played = np.zeros((1, MAX_AXES)) if samples is None else samples
        return self.cell.play(configuration, seconds, played, process=self.process)[::every]

    def path(self, configuration: Configuration, axis: str) -> FeedbackPath:
        """What the sensors and the output of `axis` take."""
        return feedback_path(configuration, self.cell.prepared.wiring, axis)
