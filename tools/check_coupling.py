"""``make check-coupling``: what coupling of the axes costs in virtual time, ignored and decoupled.

The tuned cell gets other couplings, of geometry (what a sensor sees) and through the flexure (a push on the stage).
Each is measured as `commission` does it. Then the same path, with the same seed, is played without coupling, with it
ignored, and decoupled by what was measured: without noise and process, and with both. Last, cells whose plants and
couplings are drawn, with the tuning of the file.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.design.commission.coupled import look_at_coupling
from micromanip.design.coupling.cost import costs
from micromanip.design.loops import draw
from micromanip.errors import CheckFailed
from micromanip.settings.check import Prepared, prepare
from micromanip.settings.schema.model import Configuration
from micromanip.virtual.experiment import VirtualExperiment, with_options
from micromanip.virtual.switched import COUPLING, NOISE, play_without, simulated_driver
from micromanip.virtual.variation import VariedCell

Array = NDArray[np.float64]

CONFIG = Path(__file__).parents[1] / "config" / "simulated.yaml"
SECONDS, SEED, DRAWN = 8.0, 1, 20
CASES = (("geometry", 0.02, 0.0), ("geometry", 0.05, 0.0), ("flexure", 0.0, 0.02), ("flexure", 0.0, 0.05))
_MOST_GEOMETRY, _MOST_FLEXURE = 0.05, 0.05
_SETTLED = 20_000


@dataclass(frozen=True)
class Found:
    """Path errors in um rms by axis: without coupling, ignored, decoupled; the added parts; what was predicted.

    `limited`: axes at an end of their range in any of the three runs, which then differ by more than coupling.
    """

    without: Array
    ignored: Array
    decoupled: Array
    added: Array
    left: Array
    predicted: Array
    interaction: float
    limited: NDArray[np.bool_]


def coupled(prepared: Prepared, couplings: Array, flexure: float) -> Prepared:
    """The cell with other couplings."""
    name = simulated_driver(prepared)
    options = prepared.wiring.options[name].model_copy(
        update={"couplings": tuple(map(tuple, couplings.tolist())), "flexure_coupling": flexure}
    )
    return with_options(prepared, name, options)


def of_size(share: float) -> Array:
    """Couplings (3, 3): `share` of the next axis, and 2/3 of it the other way round of the one after."""
    return np.asarray(
        np.eye(3) + share * (np.eye(3, k=1) + np.eye(3, k=-2)) - share / 1.5 * (np.eye(3, k=2) + np.eye(3, k=-1))
    )


def decoupling(configuration: Configuration) -> Configuration:
    """The same with what its axes' sections say decoupled."""
    axes = dict(configuration.axes)
    for name, axis in axes.items():
        if axis.coupling is not None:
            section = axis.coupling.model_copy(update={"decouple": True})
            axes[name] = axis.model_copy(update={"coupling": section})
    return configuration.model_copy(update={"axes": axes})


def tried(prepared: Prepared, off: tuple[str, ...]) -> Found:
    """One cell, with the causes `off` left out of what is played."""
    experiment = VirtualExperiment(prepared)
    found = look_at_coupling(prepared.configuration, experiment, SEED)
    noted = found.noted(prepared.configuration)
    motion = np.asarray(experiment(noted, SECONDS)["axis"]["stage_um"][_SETTLED::10, :3], dtype=float)
    predicted = costs(noted, found.coupling, motion, 0.1 * noted.loop.rate_hz)
    played = [
        play_without(replace(prepared, configuration=configuration), causes, SECONDS, SEED)
        for configuration, causes in ((noted, (*off, COUPLING)), (noted, off), (decoupling(noted), off))
    ]
    errors = [each.error_um for each in played]
    limited = np.any([each.limited.any(axis=0) for each in played], axis=0)
    rms = [np.sqrt(np.mean(each**2, axis=0)) for each in errors]
    added, left = (np.sqrt(np.mean((each - errors[0]) ** 2, axis=0)) for each in errors[1:])
    told = np.array([predicted[name].ignored for name in noted.axes])
    return Found(rms[0], rms[1], rms[2], added, left, told, found.together.interaction, limited)


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.3f}" for value in values)


def told(what: str, found: Found) -> str:
    """A line of a table in Markdown; figures of x, y, z."""
    columns = (found.without, found.ignored, found.decoupled, found.added, found.predicted, found.left)
    return f"| {what} | {' | '.join(map(_numbers, columns))} | {found.interaction:.2f} |"


def drawn_cells(prepared: Prepared) -> list[str]:
    """What is added to the path error of cells whose plants and couplings are drawn, without noise and process."""
    found = []
    for seed in range(DRAWN):
        rng = np.random.default_rng([seed, SEED])
        shares = np.eye(3) + rng.uniform(-_MOST_GEOMETRY, _MOST_GEOMETRY, (3, 3)) * (1.0 - np.eye(3))
        cell = coupled(prepared, shares, rng.uniform(-_MOST_FLEXURE, _MOST_FLEXURE))
        for i, axis in enumerate(cell.configuration.axes):
            cell = VariedCell(cell, axis).varied(draw(3 * seed + i).factors(), seed)
        try:
            found.append(tried(cell, NOISE))
        except CheckFailed as problem:
            sys.stderr.write(f"cell {seed}: {problem}\n")
    free = np.concatenate([~each.limited for each in found])
    without, ignored, decoupled, added, left, predicted = (
        np.concatenate([getattr(each, name) for each in found])[free]
        for name in ("without", "ignored", "decoupled", "added", "left", "predicted")
    )
    worse = decoupled > ignored
    ratio = predicted / added
    return [
        f"{len(found)} of {DRAWN} drawn cells, {len(added)} axes that no limit held: "
        f"added by coupling median {np.median(added):.3f}, "
        f"worst {added.max():.3f} um rms; decoupled median {np.median(left):.3f}, worst {left.max():.3f}",
        f"whole path error with decoupling larger than without on {np.count_nonzero(worse)} axes; on "
        f"{np.count_nonzero(worse & (ignored < without))} of them coupling had taken some of the axis' own error away",
        f"predicted over added: median {np.median(ratio):.2f}, from {ratio.min():.2f} to {ratio.max():.2f}",
        f"largest interaction {max(each.interaction for each in found):.2f}",
    ]


def main() -> None:
    """Print all of it."""
    prepared = prepare(CONFIG)
    for title, off in (("without noise and process", NOISE), ("with noise and process", ())):
        sys.stdout.write(
            f"\nPath error of x y z, um rms, {title}\n\n| coupling | none | ignored | decoupled | it adds | predicted "
            "| decoupled, it adds | interaction |\n|---|---|---|---|---|---|---|---|\n"
        )
        for name, geometry, flexure in CASES:
            found = tried(coupled(prepared, of_size(geometry), flexure), off)
            sys.stdout.write(told(f"{100 * max(geometry, flexure):g} % {name}", found) + "\n")
            sys.stdout.flush()
    sys.stdout.write("\n" + "\n".join(drawn_cells(prepared)) + "\n")


if __name__ == "__main__":
    main()
