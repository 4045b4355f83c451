"""How much of the period one cycle takes on this machine."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from micromanip.settings.check import Prepared

from .cell import VirtualCell

_BLOCKS, _BLOCK_S = 10, 0.05


@dataclass(frozen=True)
class CycleBudget:
    """Measured in virtual time, with the simulated drivers inside: nanoseconds a cycle."""

    period_ns: int
    cycle_ns: float

    @property
    def share(self) -> float:
        """Part of the period that is computed."""
        return self.cycle_ns / self.period_ns


def measure(prepared: Prepared) -> CycleBudget:
    """Median over some blocks of TRACKING cycles; the drivers must be simulated."""
    cell = VirtualCell(prepared.parameters, prepared.wiring, prepared.samples)
    cell.arm()
    period_ns = prepared.configuration.loop.period_ns
    cycles = round(_BLOCK_S * 1e9 / period_ns)
    taken = []
    for _ in range(_BLOCKS):
        begin = time.perf_counter_ns()
        cell.run(_BLOCK_S, every=10)
        taken.append((time.perf_counter_ns() - begin) / cycles)
    return CycleBudget(period_ns, float(np.median(taken)))
