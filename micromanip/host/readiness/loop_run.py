"""The real loop process for some seconds in READY: no output moves, and its own histograms are the result."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.bus.rights import leave_cpu
from micromanip.errors import CheckFailed
from micromanip.host.controller import Controller
from micromanip.host.realtime import missing_rights
from micromanip.host.shared_memory import RingReader
from micromanip.host.statistics import durations
from micromanip.rt import mailbox as w
from micromanip.rt.states import STOP
from micromanip.settings.check import Prepared, prepared
from micromanip.settings.schema.model import Loop
from micromanip.settings.text.source import Source
from micromanip.shipped import shipped

_HEARTBEAT_S = 0.02
_MOST_ROWS = 1 << 15


@dataclass(frozen=True)
class LoopRun:
    """What one run gave: histograms of lateness and compute time (``micromanip.rt.mailbox``), and counts."""

    lateness: NDArray[np.int64]
    compute: NDArray[np.int64]
    lateness_max_ns: int
    compute_max_ns: int
    cycles: int
    overruns: int
    refused: tuple[str, ...]
    """Rights that the loop asked for and did not get."""

    def document(self) -> dict[str, Any]:
        """Counts, and durations in ns, as JSON has them."""
        return {
            "cycles": self.cycles,
            "overruns": self.overruns,
            "lateness_ns": durations(self.lateness, self.lateness_max_ns),
            "compute_ns": durations(self.compute, self.compute_max_ns),
        }


def simulated_cell(loop: Loop) -> Prepared:
    """Three axes at one in-memory plant, to be run as `loop` says; whatever it is for, no wire is touched."""
    example = Source.read(shipped("config") / "factory.yaml")
    document = {**example.data, "loop": {**loop.model_dump(), "limits": "simulation"}, "arm_on_start": False}
    return prepared(Source.of(document, example.path))


async def run_in_ready(cell: Prepared, seconds: float) -> LoopRun:
    """Run the loop process of `cell` for `seconds` after it has started.

    Raises what `Controller.start` does; CheckFailed where the loop ended early.
    """
    allowed = os.sched_getaffinity(0)
    with tempfile.TemporaryDirectory() as folder:
        controller = Controller(cell, Path(folder) / "control.sock")
        try:
            leave_cpu(cell.configuration.loop.cpu)
            await controller.start()
            reader, lateness_max_ns, compute_max_ns = RingReader(controller.ring), 0, 0
            lateness, compute = (controller.status[name].copy() for name in ("lateness", "compute"))
            overruns = int(controller.words[w.OVERRUNS])
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                controller.beat()
                if controller.process.code is not None:
                    raise CheckFailed(f"the loop process ended while it was watched: {controller.death}")
                await asyncio.sleep(_HEARTBEAT_S)
                rows = reader.read(_MOST_ROWS)
                lateness_max_ns = max(lateness_max_ns, *rows["lateness_ns"].tolist(), 0)
                compute_max_ns = max(compute_max_ns, *rows["compute_ns"][1:].tolist(), 0)
            lateness = controller.status["lateness"] - lateness
            return LoopRun(
                lateness,
                controller.status["compute"] - compute,
                lateness_max_ns,
                compute_max_ns,
                int(lateness.sum()),
                int(controller.words[w.OVERRUNS]) - overruns,
                tuple(missing_rights(int(controller.words[w.RIGHTS]))),
            )
        finally:
            os.sched_setaffinity(0, allowed)
            if controller.process.runs:
                with contextlib.suppress(CheckFailed):  # without a sign of life from us it then ends by itself
                    await controller.command(STOP)
                await controller.wait()
            for descriptor in controller.segments.descriptors:
                os.close(descriptor)
