"""The simulation in virtual time: how many seconds of the three-axis cell one second of one core computes."""

from __future__ import annotations

import time

import numpy as np

from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

from .runner import CONFIGURATION, Result, Tell

_BLOCKS, _BLOCK_S = 7, 1.0


def run(tell: Tell) -> list[Result]:
    """Multiple of real time while tracking, a telemetry row a cycle; the median over some blocks."""
    prepared = prepare(CONFIGURATION)
    cell = VirtualExperiment(prepared, process=True).cell(prepared.configuration)
    cell.arm()
    tell(f"offline: {_BLOCKS} blocks of {_BLOCK_S:g} s in virtual time")
    multiples = []
    for _ in range(_BLOCKS):
        begin = time.thread_time()
        cell.run(_BLOCK_S)
        multiples.append(_BLOCK_S / (time.thread_time() - begin))
    return [Result.of("offline", float(np.median(multiples)), "times", "real time", 1.0)]
