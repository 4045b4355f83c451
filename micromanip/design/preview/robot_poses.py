"""Deviation of a real robot from measured poses: the commanded grid, a laser tracker's readings, straight runs in it.

A table of poses as christianlandgraf/ipa-robot-accuracy has it: the tool's commanded pose in the robot's base (m and
rad, roll about x, then pitch about y, then yaw about z, all fixed), the target's position as measured (mm, in the
tracker's frame), the temperature. Where the tracker stands and where the target is on the tool is not known, so both
are fitted first, to all poses together:

    m = R (p + G l) + t

with p, G the commanded pose, l the target on the tool, R, t the tracker in the base. What the fit leaves, turned back
into the base, is the robot's error; the deviation is its negative, commanded minus measured. A rigid error of the
robot's base or tool goes into R, t and l, as it would where a cell is set up by measuring.

Poses are measured at rest. A path in time is made of them: a straight run of neighbouring grid points of one
orientation, passed at an assumed feed, a monotone cubic between the points. Geometry is real, time is not; what the
robot's joints do on their way is not in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.recordings.path_deviation import PathDeviation
from micromanip.recordings.reading import read_table
from micromanip.recordings.table import Table

Array = NDArray[np.float64]

AXES = ("x", "y", "z")
_ANGLES = ("roll", "pitch", "yaw")
_SAME_M, _SAME_RAD = 1e-3, 1e-3
"""Poses that are nearer than this were meant to be the same."""
_LOSS_MM = 1.0
"""Residual beyond which a pose counts less in the fit."""


@dataclass(frozen=True)
class Poses:
    """Commanded position (n, 3) in m and rotation (n, 3, 3), measured position (n, 3) in mm, temperature (n,) in C."""

    file: Path
    position_m: Array
    angles_rad: Array
    measured_mm: Array
    temperature_C: Array

    @property
    def rotation(self) -> Array:
        """Rotation matrices (n, 3, 3) from tool to base."""
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_euler("xyz", self.angles_rad).as_matrix())


def read_poses(file: Path) -> Poses:
    """CheckFailed, with the line, where the table has not the columns, or a pose has no number."""
    table = read_table(file)

    def columns(names: list[str]) -> Array:
        missing = [name for name in names if name not in table]
        if missing:
            raise CheckFailed(f"{file}: there is no column {missing[0]}; its columns are {', '.join(table)}")
        found = np.column_stack([table[name] for name in names])
        _refuse_gaps(table, found)
        return found

    return Poses(
        file,
        columns([f"Goal {each}" for each in AXES]),
        columns([f"Goal {each}" for each in _ANGLES]),
        columns([f"measurement_{each}" for each in AXES]),
        columns(["measurement_temperature"])[:, 0],
    )


def _refuse_gaps(table: Table, values: Array) -> None:
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise CheckFailed(f"{table.where(int(bad[0]))}: a pose without a number")


@dataclass(frozen=True)
class RobotError:
    """Deviation (n, 3) of each pose in um, commanded minus measured, along the axes of the robot's base.

    `drift_um_per_K` (3,) is the part of it that goes with the temperature, `drift_error` (3,) its standard error.
    """

    poses: Poses
    deviation_um: Array
    drift_um_per_K: Array
    drift_error: Array

    @property
    def rms_um(self) -> float:
        """Of the distance between commanded and measured."""
        return float(np.sqrt((self.deviation_um**2).sum(axis=1).mean()))


def robot_error(poses: Poses) -> RobotError:
    """Fit where the tracker stands and the target is, and the drift with temperature; what is left."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    at_mm, turned = 1e3 * poses.position_m, poses.rotation
    middle, seen_middle = at_mm.mean(axis=0), poses.measured_mm.mean(axis=0)
    start, _ = Rotation.align_vectors(poses.measured_mm - seen_middle, at_mm - middle)

    def left(x: Array) -> Array:
        """Commanded minus measured (n, 3), mm, in the base."""
        back = Rotation.from_rotvec(x[:3]).inv().apply(poses.measured_mm - seen_middle - x[3:6])
        return np.asarray(at_mm + turned @ x[6:9] - middle - back)

    def residuals(x: Array) -> Array:
        return left(x).ravel()

    guess = np.concatenate([start.as_rotvec(), np.zeros(6)])
    found = least_squares(residuals, guess, loss="soft_l1", f_scale=_LOSS_MM, x_scale="jac")
    deviation_um = 1e3 * left(found.x)
    warmer = np.column_stack([np.ones(len(at_mm)), poses.temperature_C - poses.temperature_C.mean()])
    slopes, *_ = np.linalg.lstsq(warmer, deviation_um, rcond=None)
    scatter = np.std(deviation_um - warmer @ slopes, axis=0)
    spread = max(float(np.linalg.norm(warmer[:, 1])), 1e-12)
    return RobotError(poses, deviation_um, slopes[1], np.asarray(scatter / spread))


@dataclass(frozen=True)
class Run:
    """Poses (k,) by their place in the table, one behind the other along `axis` of the base, of one orientation."""

    axis: str
    places: NDArray[np.int64]
    length_m: float


def straight_runs(poses: Poses, least: int = 5) -> list[Run]:
    """Runs of at least `least` poses, the longest first; a pose that was measured again counts once."""
    found = []
    for axis in range(3):
        others = [each for each in range(3) if each != axis]
        keys = np.column_stack(
            [np.round(poses.position_m[:, others] / _SAME_M), np.round(poses.angles_rad / _SAME_RAD)]
        )
        _, group = np.unique(keys, axis=0, return_inverse=True)
        order = np.lexsort((poses.position_m[:, axis], group.ravel()))
        ends = np.flatnonzero(np.diff(group.ravel()[order])) + 1
        for first, last in pairwise([0, *ends.tolist(), len(order)]):
            places = order[first:last]
            at = poses.position_m[places, axis]
            places = places[np.concatenate([[True], np.diff(at) > _SAME_M])]
            if len(places) >= least:
                along = poses.position_m[places, axis]
                found.append(Run(AXES[axis], places, float(along[-1] - along[0])))
    return sorted(found, key=lambda run: (-run.length_m, -len(run.places), int(run.places[0])))


def path_of(
    error: RobotError, run: Run, feed_mm_per_s: float, warming_K: float = 0.0, rate_hz: float = 100.0
) -> PathDeviation:
    """`run` at a constant `feed_mm_per_s`; the robot warms by `warming_K` evenly on the way.

    The drift comes on top of what was measured at each pose, as a part of its own.
    """
    from scipy.interpolate import PchipInterpolator

    poses = error.poses
    along_mm = 1e3 * poses.position_m[run.places, AXES.index(run.axis)]
    passed_s = (along_mm - along_mm[0]) / feed_mm_per_s
    time_s = np.arange(int(passed_s[-1] * rate_hz + 1e-6) + 1) / rate_hz
    geometry = PchipInterpolator(passed_s, error.deviation_um[run.places])(time_s)
    warmed = warming_K * time_s / passed_s[-1]
    return PathDeviation(poses.file, AXES, time_s, np.asarray(geometry + warmed[:, None] * error.drift_um_per_K))
