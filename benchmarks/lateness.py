"""Wake-up lateness of our loop process beside cyclictest: same period, priority and CPU, in turns.

Ours is the real loop in READY, the simulated cell inside, with its own histogram; it sleeps to just before the
deadline and spins the rest, cyclictest sleeps all the way: the spin is the price. Our percentiles are good to 3 %.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.bus.rights import leave_cpu
from micromanip.errors import CheckFailed
from micromanip.host.controller import Controller
from micromanip.host.realtime import missing_rights
from micromanip.host.statistics import durations
from micromanip.rt import mailbox as w
from micromanip.rt.states import STOP
from micromanip.settings.check import Prepared, prepare

from . import cyclictest
from .plan import Plan
from .results import Result, Skipped

_PERCENTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999, "p99_99": 0.9999}
_HEARTBEAT_S = 0.02


def run(plan: Plan) -> list[Result]:
    """Microseconds; value and reference are medians over the pairs, the ratio is the median of the pairs' ratios."""
    cyclictest.require_cyclictest()
    prepared = prepare(plan.configuration)
    loop = prepared.configuration.loop
    if loop.cpu is None:
        raise Skipped("the configuration leaves the loop's CPU free (loop.cpu); there is nothing to pin cyclictest to")
    rows = []
    for pair in range(plan.pairs):
        plan.tell(f"lateness: pair {pair + 1} of {plan.pairs}, {plan.lateness_s:g} s each")
        ours = asyncio.run(_ours(prepared, plan.lateness_s))
        counts = cyclictest.measure(loop.period_ns, loop.priority, loop.cpu, plan.lateness_s)
        rows.append([(ours[name], cyclictest.percentile(counts, share)) for name, share in _PERCENTILES.items()])
    taken = np.array(rows, dtype=float) * 1e-3
    return [_result(name, taken[:, i]) for i, name in enumerate(_PERCENTILES)]


def _result(name: str, pairs: NDArray[np.float64]) -> Result:
    value, reference = np.median(pairs, axis=0)
    ratio = float(np.median(pairs[:, 0] / pairs[:, 1]))
    return Result(f"lateness_{name}", float(value), "us", "cyclictest", float(reference), ratio)


async def _ours(prepared: Prepared, seconds: float) -> dict[str, int]:
    """Percentiles (ns) of the loop process over `seconds` in READY; raises Skipped without real-time rights."""
    allowed = os.sched_getaffinity(0)
    with tempfile.TemporaryDirectory() as folder:
        controller = Controller(prepared, Path(folder) / "control.sock")
        try:
            leave_cpu(prepared.configuration.loop.cpu)
            await controller.start()
            refused = missing_rights(int(controller.words[w.RIGHTS]))
            if refused:
                raise Skipped("; ".join(refused))
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                controller.beat()
                await asyncio.sleep(_HEARTBEAT_S)
            return durations(controller.status["lateness"].copy(), 0)
        finally:
            os.sched_setaffinity(0, allowed)
            if controller.process is not None and controller.process.returncode is None:
                with contextlib.suppress(CheckFailed):  # without a sign of life from us it then ends by itself
                    await controller.command(STOP)
                await controller.wait()
            for descriptor in controller.segments.descriptors:
                os.close(descriptor)
