"""The error budget beside virtual experiments with causes switched off.

Each cell is played whole and without each cause, with the same noise. What the whole has more than the run without a
cause is what that cause makes; of a cause that makes less than a twentieth of the whole, that difference is lost in the
length of the run, and it is played alone instead.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from micromanip.design.analyse.budget.causes import COUPLING, CREEP, FORCE, MISFIT, PREDICTION, STAGE, STRAIN, TRACKER
from micromanip.design.analyse.budget.configured import cell_of
from micromanip.settings.check import Prepared
from micromanip.virtual.altered import NOISE, play_without

from .report import Asked, Report
from .simulated_cells import changed

SECONDS, WITHIN = 30.0, 0.15
SMALL = 0.05
CAUSES = (TRACKER, FORCE, STRAIN, STAGE)
PATH = (PREDICTION, MISFIT, CREEP, COUPLING)
NEGLIGIBLE_UM = 0.01
"""What makes less is shown, not judged: a hundredth of the whole."""


def _tracked(noise_um: float, rate_Hz: float = 1000.0) -> Callable[[Any], None]:
    def change(document: Any) -> None:
        document["drivers"]["cell"]["tracker"] |= {"noise_um": noise_um, "rate_Hz": rate_Hz}
        document["reference"] |= {"noise_um": noise_um, "sample_rate_Hz": rate_Hz}
        for own in document["reference"]["axes"].values():
            own["noise_um"] = noise_um

    return change


def _with_plant(**plant: Any) -> Callable[[Any], None]:
    def change(document: Any) -> None:
        cell = document["drivers"]["cell"]
        cell["plant"] = plant
        for varied in cell["variation"].values():
            varied |= plant

    return change


CELLS: Mapping[str, Callable[[Any], None]] = {
    "config/simulated.yaml": lambda document: None,
    "tracker noise .1 um": _tracked(0.1),
    "tracker noise 2 um": _tracked(2.0),
    "tracker 500 Hz": _tracked(0.5, 500.0),
    "Bouc-Wen, 13 kg": _with_plant(bouc_wen={}, stage_kg=13.0),
}


def compared(prepared: Prepared, seconds: float, seed: int) -> list[tuple[str, str, float, float]]:
    """Axis, cause, rms (um) computed and played, for the whole, the path, and each of `CAUSES`."""
    axes = list(prepared.configuration.axes)
    noisy = play_without(prepared, (), seconds, seed)
    whole = noisy.variance_um2
    quiet = play_without(prepared, NOISE, seconds, seed, noisy).variance_um2
    off = {cause: play_without(prepared, (cause,), seconds, seed, noisy).variance_um2 for cause in CAUSES}
    alone = {
        cause: play_without(prepared, [each for each in NOISE if each != cause], seconds, seed, noisy).variance_um2
        for cause in CAUSES
    }
    found = []
    for i, axis in enumerate(axes):
        powers = {name: float(power.sum()) for name, power in cell_of(prepared, axis).powers()[1].items()}
        total = sum(powers.values())
        found.append((axis, "whole", total, whole[i]))
        found.append((axis, "path alone", sum(powers[name] for name in PATH), quiet[i]))
        for cause in CAUSES:
            small = powers[cause] < SMALL * total
            found.append(
                (axis, cause, powers[cause], alone[cause][i] - quiet[i] if small else whole[i] - off[cause][i])
            )
    return [(axis, what, float(np.sqrt(a)), float(np.sqrt(max(b, 0.0)))) for axis, what, a, b in found]


def run(asked: Asked) -> Report:
    """Each cell; wrong is what is further off than 15 %."""
    report = Report()
    for name, change in list(CELLS.items())[: asked.count]:
        rows = []
        for axis, what, computed, played in compared(changed("simulated.yaml", change), SECONDS, asked.seed + 6):
            apart = computed / played - 1.0 if played > 0.0 else np.nan
            if max(computed, played) > NEGLIGIBLE_UM and not abs(apart) <= WITHIN:
                report.wrong.append(f"{name}, {axis}: {what}: {100 * apart:.0f} % off")
            rows.append({"axis": axis, "cause": what, "computed, um": computed, "played, um": played,
                         "off by, %": 100 * apart})  # fmt: skip
        report.tables[name] = rows
        asked.tell(f"{name}: done")
    return report
