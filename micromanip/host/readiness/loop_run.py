"""The real loop process for some seconds in READY: no output moves, and its own histograms are the result."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.bus.rights import leave_cpu
from micromanip.errors import CheckFailed
from micromanip.host.controller import Controller
from micromanip.host.realtime import missing_rights
from micromanip.host.ring import RingReader
from micromanip.rt import mailbox as w
from micromanip.rt.states import STOP
from micromanip.settings.check import Prepared, prepared
from micromanip.settings.schema.model import Loop
from micromanip.settings.text.source import Source

_HEARTBEAT_S = 0.02
_MOST_ROWS = 1 << 15
_CELL = """
schema_version: 2
loop: {{rate_hz: {rate_hz}, cpu: {cpu}, priority: {priority}, spin_us: {spin_us}, limits: simulation}}
drivers: {{cell: {{driver: simulated, seed: 1}}}}
signals:
{signals}
outputs:
{outputs}
reference: {{source: hold, offset_um: 66}}
axes:
{axes}
"""
_AXIS = """  {axis}:
    mode: strain
    centre_um: 66
    setpoint: {{range_um: [2, 128], slew_um_per_ms: 20}}
    inner: {{mode: pid, K_V_per_um: 0.6, Ti_ms: 0.571, Td_ms: 0.167, filter_ms: 0.3}}"""


@dataclass(frozen=True)
class LoopRun:
    """What one run gave: histograms of lateness and compute time (``micromanip.rt.histogram``), and counts."""

    lateness: NDArray[np.int64]
    compute: NDArray[np.int64]
    lateness_max_ns: int
    compute_max_ns: int
    cycles: int
    overruns: int
    refused: tuple[str, ...]
    """Rights that the loop asked for and did not get."""


def simulated_cell(loop: Loop) -> Prepared:
    """Three axes at one in-memory plant, to be run as `loop` says; whatever it is for, no wire is touched."""
    signals = [f"  {role}_{axis}: {{driver: cell}}" for axis in "xyz" for role in ("strain", "stage")]
    outputs = [
        f"  voltage_{axis}: {{driver: cell, range_V: [-20, 150], slew_V_per_ms: 40, park_V: 0}}" for axis in "xyz"
    ]
    text = _CELL.format(
        rate_hz=loop.rate_hz,
        cpu="null" if loop.cpu is None else loop.cpu,
        priority=loop.priority,
        spin_us=loop.spin_us,
        signals="\n".join(signals),
        outputs="\n".join(outputs),
        axes="\n".join(_AXIS.format(axis=axis) for axis in "xyz"),
    )
    return prepared(Source.parse(Path("the simulated cell of system check"), text))


async def run_in_ready(
    cell: Prepared,
    seconds: float,
    seen: Callable[[int, Any], None] = lambda *_: None,
) -> LoopRun:
    """Run the loop process of `cell` for `seconds` after it has started.

    `seen` gets its process id and, every 20 ms, the new telemetry rows; before anything is counted, none.
    Raises what `Controller.start` does; CheckFailed where the loop ended early.
    """
    allowed = os.sched_getaffinity(0)
    with tempfile.TemporaryDirectory() as folder:
        controller = Controller(cell, Path(folder) / "control.sock")
        try:
            leave_cpu(cell.configuration.loop.cpu)
            await controller.start()
            process = controller.process.pid
            reader, lateness_max_ns, compute_max_ns = RingReader(controller.ring), 0, 0
            seen(process, reader.read(0))
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
                seen(process, rows)
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
