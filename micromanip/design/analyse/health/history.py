"""The checks of an axis through the months: a CSV file with one row per check, which other programs read too.

A row has been written whole if it ends with its newline; what follows the last one is none, and the next check takes
its place. A tuning is named by its hash, as in reports: what was tuned anew is watched anew.

Four figures of an axis' plant, out of the responses that a small multisine measures while it is held.

The stage follows its set-point like a flexure, whatever closes the strain loop below: about its first mode

    G(s) = k e^(-s tau) w^2 / (s^2 + 2 zeta w s + w^2),

fitted to the lines up to half again the mode by least squares of the relative error, lines far off counting less: what
the confidence says of single lines near a mode would leave its damping to its flanks. The actuator's gain is the mean
of its response's size over its lowest lines.
"""

from __future__ import annotations

import csv
import fcntl
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from micromanip.control.injection import highest_Hz, injection
from micromanip.control.system import System
from micromanip.design.analyse.loops import flexure_mode, residues
from micromanip.errors import CheckFailed
from micromanip.files import open_regular

from ...identify.response import Measured

Array = NDArray[np.float64]

FIGURES = ("stage_gain", "mode_Hz", "mode_damping", "actuator_um_per_V")
"""um of the stage for a um of set-point, its first mode and that one's damping ratio, um of the stack for a volt."""
_ABOVE, _SCATTER, _LATEST_S = 1.5, 0.05, 2e-3
_SLOW, _LEAST_LINES = 10, 8
"""Lines that gains are the mean of; as many must lie about a mode."""
_ASTRAY = 0.15


@dataclass(frozen=True)
class PlantFigures:
    """One check of an axis; NaN where an axis has no such figure: no stage sensor, no mode, strain loop open."""

    stage_gain: float = np.nan
    mode_Hz: float = np.nan
    mode_damping: float = np.nan
    actuator_um_per_V: float = np.nan


def commissioned(model: System) -> PlantFigures:
    """The same of a configuration's `model` from set-point to stage, without its delay; of the actuator it has none.

    Where it has a mode, that flexure is fitted to its response, line by line, as to a measured one: the gain about the
    mode is not that at rest, where the strain loop below or a mode above bends the response.
    """
    poles, strengths = residues(model)
    gain = float(model.response(np.array([2 * np.pi]))[0].real)
    k = flexure_mode(poles, strengths)
    if k is None:
        return PlantFigures(stage_gain=gain)
    rate = np.log(complex(poles[k])) / model.period_s
    of_the_pole = PlantFigures(gain, float(abs(rate) / (2 * np.pi)), float(-rate.real / abs(rate)))
    rate_hz = 1.0 / model.period_s
    hertz = injection(1.0, highest_Hz(rate_hz), rate_hz, seed=1).frequency_Hz
    try:
        return PlantFigures(*_mode(hertz, model.response(2 * np.pi * hertz), of_the_pole))
    except CheckFailed:  # no flexure: what is measured of it will not be one either, and is told
        return of_the_pole


def plant_figures(stage: Measured | None, strain: Measured | None, near: PlantFigures) -> PlantFigures:
    """What the responses from set-point to stage and from voltage to gauge say; None: that loop is not closed.

    `near` are the figures to begin with. Raises CheckFailed where no mode is found in the stage's response.
    """
    actuator = np.nan
    if strain is not None:
        slow = np.argsort(strain.frequency_Hz)[:_SLOW]
        actuator = float(np.exp(np.mean(np.log(np.abs(strain.response[slow])))))
    if stage is None:
        return PlantFigures(actuator_um_per_V=actuator)
    if np.isnan(near.mode_Hz):
        slow = np.argsort(stage.frequency_Hz)[:_SLOW]
        return PlantFigures(stage_gain=float(np.mean(stage.response[slow].real)), actuator_um_per_V=actuator)
    gain, mode_Hz, damping = _mode(stage.frequency_Hz, stage.response, near)
    return PlantFigures(gain, mode_Hz, damping, actuator)


def _mode(lines_Hz: Array, stage: NDArray[np.complex128], near: PlantFigures) -> tuple[float, float, float]:
    """Gain, mode and damping: the mode first where the response is highest, then all by least squares."""
    upper = lines_Hz <= _ABOVE * near.mode_Hz
    if np.count_nonzero(upper) < _LEAST_LINES:
        raise CheckFailed(f"only {np.count_nonzero(upper)} lines lie below {_ABOVE * near.mode_Hz:.0f} Hz")
    hertz, response = lines_Hz[upper], stage[upper]
    s = 2j * np.pi * hertz

    def modelled(x: Array) -> NDArray[np.complex128]:
        w = 2 * np.pi * np.exp(x[1])
        return np.asarray(np.exp(x[0] - s * x[3]) * w**2 / (s**2 + 2 * np.exp(x[2]) * w * s + w**2))

    def residual(x: Array) -> Array:
        apart = modelled(x) / response - 1.0
        return np.concatenate([apart.real, apart.imag])

    highest = float(hertz[np.argmax(np.abs(response))])
    starts = [[np.log(near.stage_gain), np.log(f), np.log(near.mode_damping), 1e-4] for f in (near.mode_Hz, highest)]
    bounds = ([-7.0, np.log(0.3 * near.mode_Hz), -9.0, 0.0], [7.0, np.log(3.0 * near.mode_Hz), 0.0, _LATEST_S])
    fits = (
        least_squares(residual, np.clip(x, *bounds), bounds=bounds, loss="soft_l1", f_scale=_SCATTER) for x in starts
    )
    found = min(fits, key=lambda fit: float(fit.cost))
    apart = float(np.median(np.abs(modelled(found.x) / response - 1.0)))
    if apart > _ASTRAY:
        raise CheckFailed(
            f"no mode near {near.mode_Hz:.0f} Hz fits the stage's response: a line is {100 * apart:.0f} % off, "
            f"{100 * _ASTRAY:.0f} % may be; measure it held (`micromanip hold`), or commission the axis again"
        )
    gain, mode, damping = np.exp(found.x[:3])
    return float(gain), float(mode), float(damping)


MARGINS = ("stage_gain_dB", "stage_phase_deg")
COLUMNS = (*FIGURES, *MARGINS)
LABELS = {
    "stage_gain": "stage gain, um/um",
    "mode_Hz": "mode, Hz",
    "mode_damping": "damping ratio",
    "actuator_um_per_V": "actuator, um/V",
    "stage_gain_dB": "gain margin, dB",
    "stage_phase_deg": "phase margin, deg",
}
"""For people."""
HEADER = ("time", "axis", "tuning", *COLUMNS)


@dataclass(frozen=True)
class Check:
    """One check: when (UTC), of which axis under which tuning, and its figures by the names of `COLUMNS`, or NaN.

    `deviations` are those of the `MARGINS`, of a check that was just made; the file does not keep them.
    """

    time: datetime
    axis: str
    tuning: str
    figures: dict[str, float]
    deviations: Mapping[str, float] = field(default_factory=dict)

    def row(self) -> list[str]:
        """As in the file; an empty field where there is no such figure."""
        values = ("" if math.isnan(value) else f"{value:.7g}" for value in (self.figures[name] for name in COLUMNS))
        return [self.time.isoformat(timespec="seconds"), self.axis, self.tuning, *values]


def read_history(file: Path) -> list[Check]:
    """All checks in the order of the file, none where there is no file yet; CheckFailed says what is wrong where."""
    try:
        with open_regular(file) as opened:
            text = opened.read().decode("utf-8-sig")
    except FileNotFoundError:
        return []
    except UnicodeDecodeError:
        raise CheckFailed(f"{file}: no text in UTF-8: is it a history of `micromanip analyse health`?") from None
    lines = text[: text.rfind("\n") + 1].splitlines()
    if not lines:
        return []
    rows = list(csv.reader(lines))
    if tuple(rows[0]) != HEADER:
        raise CheckFailed(f"{file}:1: no history of `micromanip analyse health`: its first line is {','.join(HEADER)}")
    return [_check(file, number, row) for number, row in enumerate(rows[1:], 2)]


def append(file: Path, check: Check) -> None:
    """Add a row, whole or not at all, after what `read_history` finds; CheckFailed, OSError where it can't be."""
    descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        read_history(file)  # nothing is added to what is not one
        kept = os.pread(descriptor, os.fstat(descriptor).st_size, 0).rfind(b"\n") + 1
        text = "" if kept else ",".join(HEADER) + "\n"
        os.ftruncate(descriptor, kept)
        os.pwrite(descriptor, (text + ",".join(check.row()) + "\n").encode(), kept)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _check(file: Path, number: int, row: list[str]) -> Check:
    where = f"{file}:{number}"
    if len(row) != len(HEADER):
        raise CheckFailed(f"{where}: {len(row)} fields, {len(HEADER)} are expected: {','.join(HEADER)}")
    try:
        time = datetime.fromisoformat(row[0])
    except ValueError:
        raise CheckFailed(f"{where}: time: {row[0]!r:.40} is no time like 2026-11-23T06:00:00+00:00") from None
    figures = {}
    for name, text in zip(COLUMNS, row[3:], strict=True):
        try:
            figures[name] = float(text) if text else math.nan
        except ValueError:
            raise CheckFailed(f"{where}: {name}: {text!r:.40} is not a number with a decimal point") from None
    return Check(time if time.tzinfo else time.replace(tzinfo=UTC), row[1], row[2], figures)
