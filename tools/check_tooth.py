"""What the tooth leaves where the spindle turns at another speed than was said: `make check-tooth` prints it.

Virtual time, the truth of the simulation, seeds fixed below. The common cell as config/simulated.yaml has it, and drawn
plants as `commission` leaves them, each with the frequency fixed and with it followed.
"""

import argparse
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from micromanip.design.commission.followed import RANGE_PERCENT
from micromanip.design.experiment import with_axis
from micromanip.settings.check import Prepared
from micromanip.virtual.experiment import VirtualExperiment, with_options
from micromanip.virtual.switched import simulated_driver
from tools.accuracy.cells import AXIS, FIRST_PLANT, SLEW_UM_PER_MS, changed, commissioned, tuned
from tools.robustness.campaign import narrowed
from tools.robustness.family import drawn_cell

PLAYED_SEED, START_S, AFTER_S, PLAYED_S, PLANTS = 7, 3.0, 1.0, 8.0, 8
_UNLIKE = {"harmonics": (0.3, 0.15), "runout": 0.1}
SPEEDS: Mapping[str, Mapping[str, Any]] = {
    "as said": {},
    "0.2 Hz faster": {"tooth_Hz": 200.2},
    "0.2 Hz slower": {"tooth_Hz": 199.8},
    "2 % faster": {"tooth_Hz": 204.0},
    "2 % slower": {"tooth_Hz": 196.0},
    "1 % faster within 2 s": {"speed_percent": 1.0, "speed_after_s": 2.0, "speed_within_s": 2.0},
    "1 % slower within 0.3 s of the entry": {"speed_percent": -1.0, "speed_within_s": 0.3},
    "as said, harmonics and run-out": _UNLIKE,
    "0.2 Hz faster, harmonics and run-out": {"tooth_Hz": 200.2, **_UNLIKE},
    "10 % faster: given up": {"tooth_Hz": 220.0},
    "tool in the air": {"tooth_N": 0.0},
}
Left = dict[str, list[float]]
"""By speed: rms of the path error (um) of each axis."""


def left(prepared: Prepared, range_percent: float) -> Left:
    """The tooth followed over that range, or fixed, at every speed; from `AFTER_S` after the tool's entry on."""
    configuration, name = prepared.configuration, simulated_driver(prepared)
    for axis, settings in configuration.axes.items():
        assert settings.outer is not None
        outer = settings.outer.model_copy(update={"oscillation_range_percent": range_percent})
        configuration = with_axis(configuration, axis, outer=outer)
    driver: Any = prepared.wiring.drivers[name]
    found: Left = {}
    for speed, said in SPEEDS.items():
        force = driver.options.force.model_copy(update={"start_s": START_S, **said})
        options = driver.options.model_copy(update={"seed": PLAYED_SEED, "force": force})
        experiment = VirtualExperiment(with_options(prepared, name, options), process=True)
        cell = experiment.cell(configuration)
        passed = len(cell.arm()) * configuration.loop.period_ns * 1e-9
        cell.run(START_S + AFTER_S - passed, every=1000)
        rows = cell.run(PLAYED_S)["axis"]
        experiment.require_no_fault(cell)
        count = len(configuration.axes)
        found[speed] = [float(np.sqrt(np.mean(rows["path_error_um"][:, i] ** 2))) for i in range(count)]
    return found


def drawn(plants: int) -> tuple[dict[int, tuple[Left, Left]], list[str]]:
    """By seed: fixed and followed; and what is to be told of them."""
    prepared, found, told = changed("factory.yaml", [AXIS]), {}, []
    for seed in range(FIRST_PLANT, FIRST_PLANT + plants):
        cell, _, reach = drawn_cell(prepared, AXIS, seed)
        narrow = narrowed(prepared.configuration, reach)
        setpoint = narrow.axes[AXIS].setpoint.model_copy(update={"slew_um_per_ms": SLEW_UM_PER_MS})
        made = commissioned(cell, with_axis(narrow, AXIS, setpoint=setpoint))
        missed = [f"{c.name}: {c.value}" for story in made.evidence for c in story.criteria if not c.passed]
        outer = made.configuration.axes[AXIS].outer
        if made.stopped is not None or missed or outer is None or outer.oscillation_Hz is None:
            told.append(f"{seed}: not commissioned: {made.stopped or missed[:1] or 'no tooth'}")
        else:
            at_work = tuned(cell, made.configuration)
            found[seed] = left(at_work, 0.0), left(at_work, RANGE_PERCENT)
            decided = made.production.decided[-1] if made.production is not None else ""
            fixed, followed = found[seed]
            cells = ", ".join(f"{speed} {fixed[speed][0]:.3f} / {followed[speed][0]:.3f}" for speed in SPEEDS)
            said = f"{seed}: {outer.oscillation_Hz:g} Hz, {outer.oscillation_um:g} um; {decided}"
            told.append(f"{said} Fixed / followed: {cells}")
        sys.stderr.write(told[-1] + "\n")
    return found, told


def main() -> int:
    """Print the table in Markdown, and a line for each drawn plant."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=PLANTS, help="How many plants are drawn.")
    given = parser.parse_args()
    own = changed("simulated.yaml", "xyz")
    fixed, followed = left(own, 0.0), left(own, RANGE_PERCENT)
    for speed in SPEEDS:
        sys.stderr.write(f"{speed}: {fixed[speed]} {followed[speed]}\n")
    plants, told = drawn(given.plants)
    kinds = ("x, y, z: fixed", "followed", "drawn, median: fixed", "followed", "drawn, worst: fixed", "followed")
    sys.stdout.write(f"| speed | {' | '.join(kinds)} |\n")
    sys.stdout.write("|---|---|---|---|---|---|---|\n")
    for speed in SPEEDS:
        common = [", ".join(f"{um:.3f}" for um in each[speed]) for each in (fixed, followed)]
        every = np.array([[each[speed][0] for each in pair] for pair in plants.values()])
        spread = [f"{um:.3f}" for um in (*np.median(every, axis=0), *every.max(axis=0))]
        sys.stdout.write(f"| {speed} | {' | '.join((*common, *spread))} |\n")
    sys.stdout.write("".join(f"- {line}\n" for line in told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
