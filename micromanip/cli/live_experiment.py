"""An experiment in real time: the daemon runs a variant of the configuration and its rows are read back."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
import time
from dataclasses import replace
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
from micromanip.settings.check import Prepared
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import FeedbackPath, feedback_path
from micromanip.virtual.own_time import at_own_time

from .live import LiveLine

_RESUMED_S = 3600.0
"""What a run left that was broken off longer ago is of another day's stage."""


class Recordings:
    """The recordings of a run's experiments, in their order: those of a run that was broken off are not made again."""

    def __init__(self, folder: Path) -> None:
        if folder.is_dir() and time.time() - folder.stat().st_mtime > _RESUMED_S:
            shutil.rmtree(folder)
        folder.mkdir(exist_ok=True)
        self._folder, self.asked = folder, 0
        self.left = len(list(folder.glob("*.mcap")))
        """How many such a run has left."""

    def next(self, *asked: bytes) -> Path:
        """Where that of the next experiment belongs, of which `asked` is all that it follows from."""
        self.asked += 1
        return self._folder / f"{self.asked:03}-{hashlib.sha256(b'|'.join(asked)).hexdigest()[:16]}.mcap"


def play(
    prepared: Prepared, variant: Configuration, samples: NDArray[np.float64], duration_s: float, socket_path: Path,
    line: LiveLine, *, process: bool = False, kept: Recordings | None = None,
) -> NDArray[Any]:  # fmt: skip
    """Rows, one per cycle, of `duration_s` of TRACKING with `samples` played; the loop arms and stops softly.

    Each sample stands at its own time, see `at_own_time`. `process` keeps the machining force of a simulation.
    With `kept`, what a run has left that was broken off is read instead. Raises Ended where a fault ended it, else
    CheckFailed where cycles are missing; with `kept` KeyboardInterrupt where a signal ended it.
    """
    from micromanip.host.daemon import Options, serve

    armed = variant.model_copy(update={"arm_on_start": True})
    drivers = prepared.wiring.drivers
    at_rest_drivers = {name: driver if process else driver.without_process() for name, driver in drivers.items()}
    wiring = replace(prepared.wiring, drivers=at_rest_drivers)
    experiment = replace(
        prepared, configuration=armed, wiring=wiring, samples=samples, parameters=compile_cell(armed, wiring)
    )
    at_rest = np.zeros(1, CELL_STATE)[0]
    arming_s = int(planned_cycles(experiment.parameters[0], at_rest)) * variant.loop.period_ns * 1e-9
    with tempfile.TemporaryDirectory(prefix="micromanip-") as folder:
        file = Path(folder) / "experiment.mcap"
        if kept is not None:
            asked = (prepared.source.hash, variant.model_dump_json(), f"{duration_s} {process}")
            file = kept.next(*map(str.encode, asked), samples.tobytes())
        if not file.exists():
            made, line.planned_s = Path(folder) / "experiment.mcap", arming_s + duration_s + 0.5
            options = Options(socket_path, line.planned_s, made, whole=kept is not None)
            report = serve(experiment, options, line.say, line.show)
            if report["faults"]:
                said = f"the experiment was ended by a fault: {report['faults'][0]}"
                raise Ended(said, _rows(made)) if made.exists() else CheckFailed(said)
            recorded = report["recording"]
            if recorded is not None and recorded["message"] is not None:
                raise CheckFailed(f"the experiment was not recorded: {recorded['message']}")
            shutil.move(made, file)
        rows = _rows(file)
    rows = rows[rows["state"] == TRACKING][: round(duration_s * variant.loop.rate_hz)]
    wanted = np.arange(rows["cycle"][0], rows["cycle"][-1] + 1) if len(rows) else np.arange(0)
    if len(wanted) < 0.99 * duration_s * variant.loop.rate_hz:
        raise CheckFailed("the experiment was cut short")
    # a cycle that an overrun skipped held its output: its row is that of the cycle before
    rows = rows[np.searchsorted(rows["cycle"], wanted, side="right") - 1]
    return at_own_time(rows, variant, prepared.wiring)


def _rows(file: Path) -> NDArray[Any]:
    return np.concatenate(list(open_telemetry(file).rows()))


class LiveExperiment:
    """Experiments through the running loop, one start of the controller each; see `micromanip.design.experiment`."""

    def __init__(self, prepared: Prepared, socket_path: Path, kept: Recordings, *, process: bool = False) -> None:
        """`process` keeps the machining force, which an experiment is normally free of."""
        self._prepared, self._socket_path, self._kept, self._process = prepared, socket_path, kept, process

    def __call__(
        self,
        configuration: Configuration,
        seconds: float,
        samples: NDArray[np.float64] | None = None,
        every: int = 1,
    ) -> NDArray[Any]:
        """Rows, one in `every` cycles, of the `seconds` after tracking began."""
        played = np.zeros((1, MAX_AXES)) if samples is None else samples
        with LiveLine() as line:
            kept, path, process = self._kept, self._socket_path, self._process
            rows = play(self._prepared, configuration, played, seconds, path, line, process=process, kept=kept)
            return rows[::every]

    def path(self, configuration: Configuration, axis: str) -> FeedbackPath:
        """What the sensors and the output of `axis` take."""
        return feedback_path(configuration, self._prepared.wiring, axis)
