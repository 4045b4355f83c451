"""How long one cycle takes on this machine."""

from __future__ import annotations

import time

import numpy as np

from micromanip.settings.check import Prepared

from .cell import VirtualCell

_BLOCKS, _BLOCK_S = 10, 0.05


def measured_cycle_ns(prepared: Prepared) -> float:
    """Median over some blocks of TRACKING cycles, with the drivers inside, which must be simulated."""
    cell = VirtualCell(prepared.parameters, prepared.wiring, prepared.samples)
    cell.arm()
    cycles = round(_BLOCK_S * 1e9 / prepared.configuration.loop.period_ns)
    taken = []
    for _ in range(_BLOCKS):
        begin = time.perf_counter_ns()
        cell.run(_BLOCK_S, every=10)
        taken.append((time.perf_counter_ns() - begin) / cycles)
    return float(np.median(taken))
