"""Compiles all that has the cycle of the cell built in, by one process, before `make test` starts many.

    python -m tools.compiled [run]

With `run` it compiles what `make run` uses, and no more.

The loop, its copy in virtual time, the replay of rows and the shadow of a tuning consist of the same laws. Numba keeps
machine code of each, but what it finds out about a law (two thirds of the time) only within a process: four processes
would find it out four times, each worker of pytest once more. The same of a single cycle, which is held against its C
twin: a quarter of the time that it takes alone.
"""

from __future__ import annotations

import sys

import numpy as np
from micromanip_drivers.simulated.driver import SimulatedCell

from micromanip.cli.progress import show_compiling
from micromanip.replay.fitting import displacements
from micromanip.replay.kernel import replay_rows
from micromanip.rt.cell import cell_cycle
from micromanip.rt.cycle import run_virtual
from micromanip.rt.jit import Compiled, prepare
from micromanip.rt.loop import run_loop
from micromanip.rt.record import MAX_AXES
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE, MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.rt.shadow import shadow_cycle, start_shadow, swap_cell, takes_back
from micromanip.rt.states import NO_COMMAND


def main(only: str = "") -> None:
    """Compile, or find it in the cache."""
    show_compiling()
    prepare(run_loop, run_virtual)
    SimulatedCell(SimulatedCell.Options(), 100_000).functions()
    if only == "run":
        return
    prepare(replay_rows, displacements)
    Compiled.laws_compiled = True  # as the tests call a law
    p, s = (np.zeros(2, kind) for kind in (CELL_PARAMETERS, CELL_STATE))
    start_shadow(p[0], p[1], s[0], s[1])
    shadow_cycle(p[0], p[1], s[0], s[1], np.zeros((0, MAX_AXES)), 0)
    takes_back(p[0], s[0])
    swap_cell(p[0], p[1], s[0])
    signals, outputs = np.zeros(MAX_SIGNALS, SIGNAL), np.zeros(MAX_OUTPUTS)
    cell_cycle(p[0], s[0], signals, outputs, np.zeros((1, MAX_AXES)), NO_COMMAND, s[0]["cycle"])


if __name__ == "__main__":
    main(*sys.argv[1:])
