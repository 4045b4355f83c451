"""Wake-up lateness of our loop process beside cyclictest: same period, priority and CPU, in turns.

Ours is the real loop in READY, the simulated cell inside, with its own histogram; it sleeps to just before the
deadline and spins the rest, cyclictest sleeps all the way: the spin is the price. Our percentiles are good to 3 %.
"""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.host.readiness.loop_run import run_in_ready
from micromanip.host.statistics import durations
from micromanip.settings.check import Prepared, prepare
from micromanip.settings.schema.model import Loop

from .runner import CONFIGURATION, PAIRS, Result, Skipped, Tell

_PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99_9": 99.9, "p99_99": 99.99}
_SECONDS, _LONGEST_NS = 2.0, 1_000_000
"""Of one measurement. The histogram of cyclictest ends there; what is later counts as its maximum."""


def run(tell: Tell) -> list[Result]:
    """Microseconds; value and reference are medians over the pairs, the ratio is the median of the pairs' ratios."""
    if shutil.which("cyclictest") is None:
        raise Skipped("there is no cyclictest; install Debian package rt-tests")
    cell = prepare(CONFIGURATION)
    loop = cell.configuration.loop
    if loop.cpu is None:
        raise Skipped("the configuration leaves the loop's CPU free (loop.cpu); there is nothing to pin cyclictest to")
    pairs = []
    for pair in range(PAIRS):
        tell(f"lateness: pair {pair + 1} of {PAIRS}, {_SECONDS:g} s each")
        pairs.append((_ours(cell, _SECONDS), _cyclictest(loop, _SECONDS)))
    return [Result.of_pairs(f"lateness_{name}", np.array(pairs)[:, :, i] * 1e-3, "us", "cyclictest")
            for i, name in enumerate(_PERCENTILES)]  # fmt: skip


def _ours(cell: Prepared, seconds: float) -> list[float]:
    """Percentiles (ns) of the loop process over `seconds` in READY; raises Skipped without real-time rights."""
    taken = asyncio.run(run_in_ready(cell, seconds))
    if taken.refused:
        raise Skipped("; ".join(taken.refused))
    found: Any = durations(taken.lateness, taken.lateness_max_ns)
    return [found[name] for name in _PERCENTILES]


def _cyclictest(loop: Loop, seconds: float) -> list[float]:
    """The same of one thread; raises Skipped where it may not run."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = ["cyclictest", "--threads=1", f"--priority={loop.priority}", f"--affinity={loop.cpu}", "--mlockall"]
        command += ["--quiet", f"--interval={loop.period_ns // 1000}", f"--duration={max(1, round(seconds))}s"]
        command += ["--nsecs", f"--histogram={_LONGEST_NS}", f"--histfile={folder}/histogram", f"--json={report}"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0 or not report.is_file():
            said = (done.stderr or done.stdout).strip().splitlines() or [f"exit code {done.returncode}"]
            raise Skipped(f"cyclictest does not run here: {said[-1]}")
        thread = json.loads(report.read_text(encoding="utf-8"))["thread"]["0"]
    counts = thread["histogram"]
    late_ns = np.repeat([int(ns) for ns in counts], list(counts.values()))
    beyond = np.full(max(0, thread["cycles"] - len(late_ns)), thread["max"])
    return list(np.percentile(np.append(late_ns, beyond), list(_PERCENTILES.values()), method="higher"))
