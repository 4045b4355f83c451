"""``make check-learning``: five identical parts on cells whose plants are drawn, learned from one to the next.

The tuning and the model are those of the file, the plants of all axes are drawn as robustness is judged for. Printed is
for each axis what repeats of the true path error in each part, the whole of the first and the last, and the floor of
noise and process; then medians and worst cases. A plant on which the cell does not track is told and counted.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from micromanip.design.learning.trial import AxisTrial, trial
from micromanip.design.loops import draw
from micromanip.errors import CheckFailed
from micromanip.settings.check import Prepared, prepare
from micromanip.virtual.variation import VariedCell

CONFIG = Path(__file__).parents[1] / "config" / "simulated.yaml"
PARTS, SECONDS, LIMIT_UM = 5, 8.0, 5.0
REPEATS_UM, OVER_FLOOR = 0.05, 1.2
"""What is asked of the last part."""
_AXES = 3


def drawn(prepared: Prepared, seed: int) -> Prepared:
    """The cell with another plant in each axis."""
    for i, axis in enumerate(prepared.configuration.axes):
        prepared = VariedCell(prepared, axis).varied(draw(_AXES * seed + i).factors(), seed)
    return prepared


def told(seed: int, axis: AxisTrial) -> str:
    """A line of one axis."""
    first, last = axis.parts[0], axis.parts[-1]
    repeats = " ".join(f"{each.repeats_um:.3f}" for each in axis.parts)
    return (
        f"{seed:4d} {axis.axis}: of {axis.uncompensated_um:.0f} um {first.whole_um:.3f}, then {last.whole_um:.3f}, "
        f"{last.over_floor:.3f} of the floor {last.floor_um:.3f}; repeats {repeats}; "
        f"{', '.join(each.verdict for each in axis.parts[1:])}"
    )


def summary(found: list[AxisTrial]) -> list[str]:
    """Medians, worst cases, and how many axes do what is asked."""
    repeats = np.array([[each.repeats_um for each in axis.parts] for axis in found])
    over = np.array([axis.parts[-1].over_floor for axis in found])
    worse = int(np.count_nonzero(repeats[:, 1:].max(axis=1) > repeats[:, 0]))
    return [
        f"repeats, part 1 to {PARTS}: median {' '.join(f'{x:.3f}' for x in np.median(repeats, axis=0))}, "
        f"worst {' '.join(f'{x:.3f}' for x in repeats.max(axis=0))} um rms",
        f"part {PARTS}: at most {REPEATS_UM:g} um repeat on {np.count_nonzero(repeats[:, -1] <= REPEATS_UM)} of "
        f"{len(found)} axes",
        f"part {PARTS}: whole over floor median {np.median(over):.3f}, worst {over.max():.3f}; at most {OVER_FLOOR:g} "
        f"on {np.count_nonzero(over <= OVER_FLOOR)} of {len(found)} axes",
        f"more repeats in a later part than in part 1 on {worse} axes, at worst by "
        f"{(repeats[:, 1:].max(axis=1) - repeats[:, 0]).max():+.3f} um",
    ]


def main() -> int:
    """Try 10 drawn plants, or as many as the argument says; 1 where an axis misses what is asked."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    prepared = prepare(CONFIG)
    found: list[AxisTrial] = []
    refused = 0
    for seed in range(count):
        try:
            axes = trial(drawn(prepared, seed), PARTS, SECONDS, 100 * seed + 1, LIMIT_UM, lambda _: None)
        except CheckFailed as problem:
            refused += 1
            print(f"{seed:4d} refused: {problem}", flush=True)
            continue
        found += axes
        for axis in axes:
            print(told(seed, axis), flush=True)
    if found:
        print("\n".join(summary(found)))
    print(f"{refused} of {count} cells refused")
    missed = [a for a in found if a.parts[-1].repeats_um > REPEATS_UM or a.parts[-1].over_floor > OVER_FLOOR]
    return int(not found or bool(missed))


if __name__ == "__main__":
    sys.exit(main())
