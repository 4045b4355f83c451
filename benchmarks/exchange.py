"""Each bus in operation: rate and age of its samples, and the processor time of what serves them.

The daemon on an example of config/ in READY, its devices emulated in a process of their own. Rates stand beside those
that are stated, ages beside the period of their signal, a worker beside the loop of the same seconds; where the loop
itself serves the bus, its cycle beside its period.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

from campaigns.bench import Bench
from campaigns.fault_cells import CELLS, example
from micromanip.errors import DeviceUnavailable

from .runner import Result, Skipped, Tell

_SECONDS = 5.0
BUSES = CELLS | {"ethercat": lambda: example("ethercat.yaml", (r"interface: ecat0", f"interface: ece{os.getpid()}"))}
del BUSES["ring"]  # the same exchange, sent twice


def run(tell: Tell) -> list[Result]:
    """Of the fastest signal of each bus that this machine can play."""
    results: list[Result] = []
    for bus, text in BUSES.items():
        tell(f"exchange: {bus}, {_SECONDS:g} s")
        with tempfile.TemporaryDirectory() as folder:
            try:
                bench = Bench(Path(folder), text())
            except DeviceUnavailable as reason:
                tell(f"exchange: no {bus}: {reason}")
                continue
            try:
                results += _measured(bus, bench)
            finally:
                bench.end()
    if not results:
        raise Skipped("none of the buses can be played here")
    return results


def _measured(bus: str, bench: Bench) -> list[Result]:
    before, loop_before_s = _seen(bench)
    time.sleep(_SECONDS)
    after, loop_after_s = _seen(bench)
    period_us = after["period_ns"] * 1e-3
    seconds = (after["cycles"] - before["cycles"]) * period_us * 1e-6
    name, signal = max(after["signals"].items(), key=lambda each: each[1]["stated_hz"])
    rate_hz = (signal["samples"] - before["signals"][name]["samples"]) / seconds
    age_us, stated_hz = signal["age_p50_us"], signal["stated_hz"]
    found = [Result.of(f"{bus}_rate", rate_hz, "Hz", "as stated", stated_hz)]
    found.append(Result.of(f"{bus}_age_p50", age_us, "us", "the period of the signal", 1e6 / stated_hz))
    used_s = sum(after["links"][link]["cpu_s"] - before["links"][link]["cpu_s"] for link in after["links"])
    if used_s > 0.0:
        worker, loop = (100.0 * each / seconds for each in (used_s, loop_after_s - loop_before_s))
        found.append(Result.of(f"{bus}_worker", worker, "% of a CPU", "the loop", loop))
    else:
        cycle_us = after["compute_ns"]["p50"] * 1e-3
        found.append(Result.of(f"{bus}_cycle_p50", cycle_us, "us", "the period of the loop", period_us))
    return found


def _seen(bench: Bench) -> tuple[Any, float]:
    """What the daemon says, and the processor time (s) that its loop has taken."""
    with bench.client() as client:
        status = client.status()
    ticks = Path(f"/proc/{bench.running.loop}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[11:13]
    return status, sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
