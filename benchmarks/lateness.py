"""Wake-up lateness of our loop process beside cyclictest: same period, priority and CPU, in turns.

Ours is the real loop in READY, the simulated cell inside, with its own histogram; it sleeps to just before the
deadline and spins the rest, cyclictest sleeps all the way: the spin is the price. Our percentiles are good to 3 %.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from micromanip.host.readiness.loop_run import run_in_ready
from micromanip.host.statistics import durations
from micromanip.settings.check import Prepared, prepare

from . import cyclictest
from .runner import Plan, Result, Skipped

_PERCENTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999, "p99_99": 0.9999}


def run(plan: Plan) -> list[Result]:
    """Microseconds; value and reference are medians over the pairs, the ratio is the median of the pairs' ratios."""
    cyclictest.require_cyclictest()
    cell = prepare(plan.configuration)
    loop = cell.configuration.loop
    if loop.cpu is None:
        raise Skipped("the configuration leaves the loop's CPU free (loop.cpu); there is nothing to pin cyclictest to")
    rows = []
    for pair in range(plan.pairs):
        plan.tell(f"lateness: pair {pair + 1} of {plan.pairs}, {plan.lateness_s:g} s each")
        ours = _ours(cell, plan.lateness_s)
        counts = cyclictest.measure(loop.period_ns, loop.priority, loop.cpu, plan.lateness_s)
        rows.append([(ours[name], cyclictest.percentile(counts, share)) for name, share in _PERCENTILES.items()])
    taken = np.array(rows, dtype=float) * 1e-3
    return [_result(name, taken[:, i]) for i, name in enumerate(_PERCENTILES)]


def _result(name: str, pairs: NDArray[np.float64]) -> Result:
    value, reference = np.median(pairs, axis=0)
    ratio = float(np.median(pairs[:, 0] / pairs[:, 1]))
    return Result(f"lateness_{name}", float(value), "us", "cyclictest", float(reference), ratio)


def _ours(cell: Prepared, seconds: float) -> Mapping[str, object]:
    """Percentiles (ns) of the loop process over `seconds` in READY; raises Skipped without real-time rights."""
    taken = asyncio.run(run_in_ready(cell, seconds))
    if taken.refused:
        raise Skipped("; ".join(taken.refused))
    return durations(taken.lateness, taken.lateness_max_ns)
