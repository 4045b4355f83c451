"""An experiment in real time: the daemon runs a variant of the configuration and its rows are read back."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.rt.arming import planned_cycles
from micromanip.rt.records import CELL_STATE, MAX_AXES
from micromanip.rt.states import TRACKING
from micromanip.settings.check import Prepared
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import FeedbackPath, feedback_path
from micromanip.virtual.own_time import at_own_time

from .live import LiveLine


def play(
    prepared: Prepared,
    variant: Configuration,
    samples: NDArray[np.float64],
    duration_s: float,
    socket_path: Path,
    line: LiveLine,
    *,
    process: bool = False,
) -> NDArray[Any]:
    """Rows, one per cycle, of `duration_s` of TRACKING with `samples` played; the loop arms and stops softly.

    Each sample stands at its own time, see `at_own_time`. `process` keeps the machining force of a simulation.
    Raises CheckFailed where a fault ended it, or cycles are missing from the recording.
    """
    from micromanip.host.daemon import Options, serve
    from micromanip.recordings import open_telemetry

    armed = variant.model_copy(update={"arm_on_start": True})
    drivers = prepared.wiring.drivers
    kept = {name: driver if process else driver.without_process() for name, driver in drivers.items()}
    wiring = replace(prepared.wiring, drivers=kept)
    experiment = replace(
        prepared, configuration=armed, wiring=wiring, samples=samples, parameters=compile_cell(armed, wiring)
    )
    at_rest = np.zeros(1, CELL_STATE)[0]
    arming_s = int(planned_cycles(experiment.parameters[0], at_rest)) * variant.loop.period_ns * 1e-9
    with tempfile.TemporaryDirectory(prefix="micromanip-") as folder:
        file = Path(folder) / "experiment.mcap"
        line.planned_s = arming_s + duration_s + 0.5
        report = serve(experiment, Options(socket_path, line.planned_s, file), line.say, line.show)
        if report["faults"]:
            raise CheckFailed(f"the experiment was ended by a fault: {report['faults'][0]}")
        recorded = report["recording"]
        if recorded is not None and recorded["message"] is not None:
            raise CheckFailed(f"the experiment was not recorded: {recorded['message']}")
        rows: NDArray[Any] = np.concatenate(list(open_telemetry(file).rows()))
    rows = rows[rows["state"] == TRACKING][: round(duration_s * variant.loop.rate_hz)]
    wanted = np.arange(rows["cycle"][0], rows["cycle"][-1] + 1) if len(rows) else np.arange(0)
    if len(wanted) < 0.99 * duration_s * variant.loop.rate_hz:
        raise CheckFailed("the experiment was cut short")
    # a cycle that an overrun skipped held its output: its row is that of the cycle before
    rows = rows[np.searchsorted(rows["cycle"], wanted, side="right") - 1]
    return at_own_time(rows, variant, prepared.wiring)


class LiveExperiment:
    """Experiments through the running loop, one start of the controller each; see `micromanip.design.experiment`."""

    def __init__(self, prepared: Prepared, socket_path: Path, *, process: bool = False) -> None:
        """`process` keeps the machining force, which an experiment is normally free of."""
        self._prepared, self._socket_path, self._process = prepared, socket_path, process

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
            kept, path = self._process, self._socket_path
            return play(self._prepared, configuration, played, seconds, path, line, process=kept)[::every]

    def path(self, configuration: Configuration, axis: str) -> FeedbackPath:
        """What the sensors and the output of `axis` take."""
        return feedback_path(configuration, self._prepared.wiring, axis)
