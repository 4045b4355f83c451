"""What is predicted of the reach of drawn paths, beside the same paths played in virtual time.

A path is a slow sine and a joint's oscillation on each axis, amplitude and speed drawn. Where the preview says that it
fits, no limit may hold while it is played. Where it does not, a limit must hold in the first stretch that it names, and
none before it, unless it has named a reserve there; what comes after a limit has held is no longer claimed. A path that
only uses a reserve, or is only followed too badly, is neither: close.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.design.analyse.path.preview import RANGE, TRACKER, VOLTAGE, preview_of
from micromanip.recordings.path_deviation import PathDeviation, read_path_deviation
from micromanip.rt.states import TRACKING
from micromanip.settings.check import Prepared, prepare
from micromanip.virtual.altered import at_limits, simulated_driver
from micromanip.virtual.experiment import VirtualExperiment, with_options

from .report import ROOT, Asked, Report

Array = NDArray[np.float64]

RESERVE_UM, TOLERANCE_UM, CORNER_HZ = 3.0, 5.0, 0.2
SECONDS, RATE_HZ = 4.0, 500.0
NARROW_V = (10.0, 125.0)
"""Volts of every second path's cell: there the voltage ends before the set-point does."""
_SLOW_UM, _SLOW_HZ, _JOINT_UM, _JOINT_HZ = (80.0, 330.0), (0.2, 1.0), (0.0, 30.0), (6.0, 14.0)
_BEGINS_S = 0.5
_ABOUT_S = 0.05
"""Around a stretch: noise meets a limit a little earlier."""
_HARD = (TRACKER, RANGE, VOLTAGE)


@dataclass(frozen=True)
class Compared:
    """One path: what the preview said, and whether the run agreed; `verdict` is fits, close or does not fit."""

    seed: int
    verdict: str
    agreed: bool
    said: str


def drawn(seed: int) -> Array:
    """Deviation (n, 3) in um of the path of `seed`, `RATE_HZ` rows a second, from rest."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    begun = np.clip(time_s / _BEGINS_S, 0.0, 1.0)
    columns = []
    for _ in range(3):
        slow_um, slow_hz, joint_um, joint_hz = (
            rng.uniform(*each) for each in (_SLOW_UM, _SLOW_HZ, _JOINT_UM, _JOINT_HZ)
        )
        slow = slow_um * np.sin(2.0 * np.pi * slow_hz * time_s + rng.uniform(0.0, 2.0 * np.pi))
        columns.append(begun**2 * (3.0 - 2.0 * begun) * (slow + joint_um * np.sin(2.0 * np.pi * joint_hz * time_s)))
    return np.column_stack(columns)


def narrowed(prepared: Prepared, range_V: tuple[float, float]) -> Prepared:
    """The cell with other limits of its voltages, parked at the lower one."""
    configuration = prepared.configuration
    outputs = {
        name: output.model_copy(update={"range_V": range_V, "park_V": range_V[0]})
        for name, output in configuration.outputs.items()
    }
    return replace(prepared, configuration=configuration.model_copy(update={"outputs": outputs}))


def played(prepared: Prepared, path: PathDeviation, seed: int) -> NDArray[Any]:
    """Rows of the cell on `path`, from its first row on, noise and all, without machining."""
    name = simulated_driver(prepared)
    options: Any = prepared.wiring.options[name]
    start_s = 4.0
    deviation = options.deviation.model_copy(update={"file": str(path.file), "start_s": start_s})
    options = options.model_copy(update={"deviation": deviation, "seed": seed})
    experiment = VirtualExperiment(with_options(prepared, name, options))
    cell = experiment.cell(prepared.configuration, prepared.samples)
    cell.run(start_s - len(cell.arm()) * prepared.configuration.loop.period_ns * 1e-9)
    return cell.run(SECONDS)


def limited(prepared: Prepared, rows: NDArray[Any]) -> NDArray[np.bool_]:
    """Cycles (n,) in which a limit holds, a tracker's sample is out of range, or the cell does not track."""
    reference: Any = prepared.configuration.reference
    low_um, high_um = reference.range_um
    deviation_um = rows["axis"]["deviation_um"][:, : len(prepared.configuration.axes)]
    unseen = (deviation_um <= low_um) | (deviation_um >= high_um)
    return np.asarray((rows["state"] != TRACKING) | (at_limits(prepared.configuration, rows) | unseen).any(axis=1))


def compare(prepared: Prepared, seed: int, folder: Path) -> Compared:
    """The preview of the path of `seed` beside its run."""
    cell = narrowed(prepared, NARROW_V) if seed % 2 else prepared
    file, columns = folder / f"path{seed}.csv", drawn(seed)
    time_s = np.arange(len(columns)) / RATE_HZ
    header = ",".join(["t_s", *(f"deviation_{axis}_um" for axis in "xyz")])
    np.savetxt(file, np.column_stack([time_s, columns]), delimiter=",", header=header, comments="", fmt="%.6f")
    path = read_path_deviation(file, "xyz")
    found = preview_of(cell, path, RESERVE_UM, TOLERANCE_UM, CORNER_HZ)
    over = sorted((each for axis in found.axes for each in axis.stretches), key=lambda each: each.from_s)
    hard = [each for each in over if each.what in _HARD]
    met_s = np.flatnonzero(limited(cell, played(cell, path, seed + 1))) * cell.configuration.loop.period_ns * 1e-9
    seen = f"first met at {met_s[0]:.3f} s" if len(met_s) else "none met"
    if hard:
        first = hard[0]
        inside = ((met_s >= first.from_s - _ABOUT_S) & (met_s <= first.to_s + _ABOUT_S)).any()
        where = f"{first.from_s:.3f} to {first.to_s:.3f} s"
        said = f"{first.axis}: {first.what} over by {first.over:.2f} {first.unit}, {where}"
        before = any(each.from_s < first.from_s for each in over)
        early = len(met_s) > 0 and met_s[0] < first.from_s - _ABOUT_S and not before
        return Compared(seed, "does not fit", bool(inside) and not early, f"{said}; {seen}")
    if over:
        return Compared(seed, "close", not len(met_s), f"{over[0].axis}: {over[0].what}; {seen}")
    return Compared(seed, "fits", not len(met_s), seen)


def run(asked: Asked) -> Report:
    """`count` paths; wrong is a verdict that the run does not bear out."""
    prepared = prepare(ROOT / "config" / "simulated.yaml")
    found: list[Compared] = []
    for seed in range(asked.count):
        found.append(compare(prepared, seed, asked.folder))
        asked.tell(f"{seed:4d} {found[-1].verdict:13s} {'agrees' if found[-1].agreed else 'DIFFERS'}: {found[-1].said}")
    rows = [
        {"predicted": verdict, "paths": paths, "borne out": sum(e.agreed for e in found if e.verdict == verdict)}
        for verdict, paths in Counter(each.verdict for each in found).items()
    ]
    differs = [each for each in found if not each.agreed and each.verdict != "close"]
    return Report({"paths": rows}, [], [f"path {each.seed}: {each.verdict}: {each.said}" for each in differs])
