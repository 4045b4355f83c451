"""A path of a real robot for preview and simulation: ``python -m tools.robot_path POSES.csv --out path.csv``.

POSES is a table of commanded and measured poses, see ``micromanip/design/preview/robot_poses.py``: the geometry is
real, the feed is assumed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from micromanip.design.preview.robot_poses import AXES, path_of, read_poses, robot_error, straight_runs


def main() -> None:
    """Write the chosen run as t_s and deviation_<axis>_um, along the axes of the robot's base."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("poses", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--run", type=int, default=0, help="which straight run, from the longest, 0")
    parser.add_argument("--feed", type=float, default=20.0, help="mm/s, assumed")
    parser.add_argument("--warming", type=float, default=0.0, help="K by which the robot warms on the way")
    given = parser.parse_args()
    error = robot_error(read_poses(given.poses))
    run = straight_runs(error.poses)[given.run]
    path = path_of(error, run, given.feed, given.warming)
    header = ",".join(["t_s", *(f"deviation_{axis}_um" for axis in AXES)])
    rows = np.column_stack([path.time_s, path.deviation_um])
    np.savetxt(given.out, rows, delimiter=",", header=header, comments="", fmt="%.4f")
    drift = ", ".join(f"{k:.0f} +- {s:.0f}" for k, s in zip(error.drift_um_per_K, error.drift_error, strict=True))
    print(
        f"{len(error.poses.position_m)} poses: {error.rms_um:.0f} um rms from commanded; with temperature {drift} um/K"
    )
    print(f"run {given.run}: {len(run.places)} poses along {run.axis}, {run.length_m:g} m, {path.time_s[-1]:.1f} s")


if __name__ == "__main__":
    main()
