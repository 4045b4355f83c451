"""One cycle of three axes, telemetry row included, beside the same cycle in plain C.

Both replay the same signals of the simulated cell from the same state, and must leave the same numbers
behind; then they are timed in turns. The stretch is short, so that both work in the processor's cache. In
``cycle_cold`` a neighbour on the core empties that before each cycle, as in the running loop; the median counts.
"""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.settings.check import prepare

from .agreement import require_agreement
from .recording import Outcome, Player, Recording, ours, record_tracking, twin_player
from .runner import Plan, Result
from .twin import require_covered

_BEGUN_S, _COMPARED_CYCLES = 0.1, 4000
STRETCH_CYCLES, REPEATS = 500, 40
SWEPT_BYTES = 4_000_000
"""More than the caches that a core has for itself."""
TRACKING_S = 1.5
"""Long enough that the path error is scored."""


def run(plan: Plan) -> list[Result]:
    """Nanoseconds a cycle; the ratio is the median over the pairs. Raises CheckFailed where the two disagree."""
    prepared = prepare(plan.configuration)
    with tempfile.TemporaryDirectory() as folder:
        twin = twin_player(Path(folder))
        _compared(record_tracking(prepared, _BEGUN_S, _COMPARED_CYCLES), twin)
        stretch = record_tracking(prepared, TRACKING_S, STRETCH_CYCLES)
        outcome = _compared(stretch, twin)
        plan.tell(f"cycle: our cycle and its C twin agree; {plan.pairs} pairs of {STRETCH_CYCLES * REPEATS} cycles")
        taken = timed([(ours, stretch, outcome), (twin, stretch, outcome)], plan.pairs)
        cold = dataclasses.replace(stretch, swept=np.zeros(SWEPT_BYTES // 8, np.int64))
        swept = timed([(ours, cold, outcome), (twin, cold, outcome)], plan.pairs, cold=True)
    return [_result("cycle", taken), _result("cycle_cold", swept)]


def _result(name: str, taken: NDArray[np.float64]) -> Result:
    value, reference = np.median(taken, axis=0)
    ratio = float(np.median(taken[:, 0] / taken[:, 1]))
    return Result(name, float(value), "ns", "C twin, gcc -O3 -march=native", float(reference), ratio)


def _compared(recording: Recording, twin: Player) -> Outcome:
    """Outcome of one replay, which both must agree on."""
    require_covered(recording.parameters)
    left, right = (Outcome.room(len(recording.signals)) for _ in range(2))
    ours(recording, left, 1)
    twin(recording, right, 1)
    require_agreement(left, right)
    return left


def timed(
    played: Sequence[tuple[Player, Recording, Outcome]], pairs: int, *, cold: bool = False
) -> NDArray[np.float64]:
    """Processor time (ns) a cycle, (pairs, 2), of two played in turns; every other pair begins with the second.

    `cold`: the median cycle of each instead, behind its neighbour's work.
    """
    taken = np.zeros((pairs, 2))
    for pair in range(pairs):
        for which in (0, 1) if pair % 2 else (1, 0):
            player, recording, outcome = played[which]
            begin = time.thread_time_ns()
            player(recording, outcome, 1 if cold else REPEATS)
            mean_ns = (time.thread_time_ns() - begin) / (len(recording.signals) * REPEATS)
            taken[pair, which] = np.median(outcome.taken_ns) if cold else mean_ns
    return taken
