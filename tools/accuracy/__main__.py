"""Writes docs/accuracy.md: ``python -m tools.accuracy``."""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import yaml

from micromanip.design.parallel import each
from micromanip.settings.schema.model import Configuration
from micromanip.settings.write import write_atomically
from tools.running_controller import MICROMANIP

from .cells import AXIS, FIRST_PLANT, changed, commissioned, drawn, tuned
from .figures import BEFORE, NOW, PATH_ROWS, SEEN, SEEN_BOUND, UNCOMPENSATED, Reached, Values, causes, played, reached
from .page import PAGE, RealLoop, page

PLANTS, REAL_S = 100, 20.0
"""How many plants are drawn (15 s of CPU each); how long the real loop runs."""
TRACKERS_UM = (0.1, 2.0)
"""Noise of other trackers; the common one has .5 um."""


def own_axes() -> tuple[Configuration, dict[str, Reached]]:
    """The common cell commissioned anew, and its axes: so, and as config/simulated.yaml has them."""
    factory, before = changed("factory.yaml", "xyz"), changed("simulated.yaml", "xyz")
    found = commissioned(factory, factory.configuration)
    if not found.passed:
        raise SystemExit("config/factory.yaml does not pass: see `micromanip commission`; nothing was written")
    now, as_it_stands = reached(tuned(factory, found.configuration)), played(before)
    return found.configuration, {
        axis: replace(each, path={row: (each.path | {BEFORE: as_it_stands[axis][NOW]})[row] for row in PATH_ROWS})
        for axis, each in now.items()
    }


def real_loop(configuration: Configuration) -> RealLoop:
    """`configuration` on the real loop, as `micromanip run` has it."""
    document = configuration.model_dump(mode="json", exclude_unset=True, by_alias=True) | {"arm_on_start": True}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "commissioned.yaml"
        file.write_text(yaml.safe_dump(document), encoding="utf-8")
        command = [MICROMANIP, "run", file, "--duration", f"{REAL_S:g}", "--socket", Path(folder) / "control", "--json"]
        told = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    rows = {UNCOMPENSATED: "uncompensated_rms", "rms": "rms", "greatest": "max"}
    path = {axis: {row: um[key] for row, key in rows.items()} for axis, um in told["path_error_um"].items()}
    machine = f"{os.cpu_count()} CPUs, Linux {platform.release()}"
    return RealLoop(path, REAL_S, told["overruns"], machine)


def other_trackers(common: dict[str, Reached]) -> dict[str, Values]:
    """By axis, what samples of noisier and quieter trackers leave beside the bound, um, each commissioned for them."""
    rows: dict[float, dict[str, Values]] = {0.5: {axis: each.causes for axis, each in common.items()}}
    for noise_um in TRACKERS_UM:
        factory = changed("factory.yaml", list(common), noise_um)
        cell = tuned(factory, commissioned(factory, factory.configuration).configuration)
        rows[noise_um] = {axis: causes(cell, axis) for axis in common}
    return {
        axis: {
            f"{noise_um:g} um of noise: {what}": rows[noise_um][axis][row]
            for noise_um in sorted(rows)
            for what, row in (("left", SEEN), ("bound", SEEN_BOUND))
        }
        for axis in common
    }


def drawn_plant(seed: int) -> Reached | str:
    """What the plant of `seed` reaches, or why it does not pass."""
    what = drawn(changed("factory.yaml", [AXIS]), seed)
    return what if isinstance(what, str) else reached(what)[AXIS]


def main() -> int:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=PLANTS, help="How many plants are drawn.")
    given = parser.parse_args()
    configuration, own = own_axes()
    real, trackers = real_loop(configuration), other_trackers(own)
    seeds, plants = range(FIRST_PLANT, FIRST_PLANT + given.plants), {}
    for seed, found in zip(seeds, each(drawn_plant, seeds, jobs=-1), strict=True):
        plants[seed] = found
        told = found if isinstance(found, str) else f"path error {found.path[NOW]:.3f} um"
        sys.stderr.write(f"plant {seed}: {told}\n")
        write_atomically(PAGE, page(own, plants, real, trackers))
    return 0


if __name__ == "__main__":
    sys.exit(main())
