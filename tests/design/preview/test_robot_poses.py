"""Deviation of a real robot: what was put in is found again, and the recorded poses of one where they are there."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micromanip.design.preview.robot_poses import Poses, path_of, read_poses, robot_error, straight_runs
from micromanip.errors import CheckFailed

DATA = Path(__file__).parents[3].parent / "shared" / "data" / "ipa_robot" / "series_A_grid.csv"


def grid(error_um, drift_um_per_K=(0.0, 0.0, 0.0)):
    """Poses on a grid in three orientations, seen by a tracker anywhere, with a robot that is `error_um` wrong."""
    rng = np.random.default_rng(3)
    axes = np.meshgrid(np.arange(0.6, 1.0, 0.1), np.arange(-0.6, 0.61, 0.1), np.arange(0.4, 0.7, 0.1), indexing="ij")
    at = np.tile(np.column_stack([axis.ravel() for axis in axes]), (3, 1))
    angles = np.repeat(np.array([[1.57, 1.2, 1.57], [1.2, 1.57, 1.4], [1.57, 1.57, 1.9]]), len(at) // 3, axis=0)
    warm = 23.0 + 0.7 * rng.random(len(at))
    off_mm = 1e-3 * (error_um(at) - np.outer(warm - warm.mean(), drift_um_per_K))
    lever = np.array([40.0, -25.0, 110.0])
    real = 1e3 * at + Rotation.from_euler("xyz", angles).apply(lever) - off_mm
    tracker = Rotation.from_euler("zyx", [2.1, -0.4, 0.9])
    return Poses(Path("poses.csv"), at, angles, tracker.apply(real) + np.array([2300.0, -900.0, 150.0]), warm)


def bowed(at):
    """No rigid motion does this: 300 um of waves across the grid."""
    return 300.0 * np.column_stack([np.sin(20.0 * at[:, 1]), np.cos(25.0 * at[:, 0]), np.sin(30.0 * at[:, 2])])


def test_a_perfect_robot_has_no_deviation_wherever_tracker_and_target_are():
    assert robot_error(grid(lambda at: 0.0 * at)).rms_um < 1e-3


def test_deviation_and_drift_are_found_but_for_a_rigid_part():
    poses = grid(bowed, drift_um_per_K=(0.0, 90.0, 0.0))
    found = robot_error(poses)
    wanted = bowed(poses.position_m)
    shared = np.column_stack([poses.position_m, np.ones(len(wanted))])  # a rigid part is linear in the position
    for values, put_in in zip(found.deviation_um.T, wanted.T, strict=True):
        rest = [each - shared @ np.linalg.lstsq(shared, each, rcond=None)[0] for each in (values, put_in)]
        assert np.corrcoef(*rest)[0, 1] > 0.98
    assert found.drift_um_per_K[1] == pytest.approx(-90.0, abs=4.0 * found.drift_error[1])


def test_straight_runs_are_passed_at_the_feed_and_warm_on_the_way():
    error = robot_error(grid(bowed, drift_um_per_K=(0.0, 90.0, 0.0)))
    runs = straight_runs(error.poses)
    longest = runs[0]
    assert (longest.axis, len(longest.places), longest.length_m) == ("y", 13, pytest.approx(1.2))
    assert all(np.ptp(error.poses.position_m[longest.places][:, [0, 2]], axis=0) == 0.0)
    cold = path_of(error, longest, 40.0)
    assert cold.time_s[-1] == pytest.approx(30.0, abs=0.011)
    every = round(2.5 / cold.even_step_s())  # 100 mm
    np.testing.assert_allclose(cold.deviation_um[::every], error.deviation_um[longest.places], atol=1e-3)
    warmed = path_of(error, longest, 40.0, warming_K=2.0).deviation_um - cold.deviation_um
    np.testing.assert_allclose(warmed[-1], 2.0 * error.drift_um_per_K, rtol=1e-2)
    assert warmed[0].tolist() == [0.0, 0.0, 0.0]


def test_a_table_without_poses_is_told(tmp_path):
    file = tmp_path / "poses.csv"
    file.write_text("t_s,x_um\n0,1\n1,2\n", encoding="utf-8")
    with pytest.raises(CheckFailed, match="there is no column Goal x"):
        read_poses(file)


@pytest.mark.long
@pytest.mark.skipif(not DATA.is_file(), reason="the real recordings are not here: ipa_robot is not beside the project")
def test_a_real_robot_is_a_millimetre_off_and_neighbouring_poses_are_more_alike_than_any_two():
    error = robot_error(read_poses(DATA))
    assert len(error.deviation_um) == 11_911
    assert 600.0 < error.rms_um < 1100.0, "a UR10 that is not calibrated"
    assert np.abs(error.deviation_um.mean(axis=0)).max() < 200.0, "the fit has taken the rigid part"
    runs = [run for run in straight_runs(error.poses) if len(run.places) == 13]
    along = np.array([error.deviation_um[run.places] for run in runs])
    any_two = np.random.default_rng(0).permutation(along.reshape(-1, 3)).reshape(along.shape)
    assert np.abs(np.diff(along, axis=1)).mean() < 0.8 * np.abs(np.diff(any_two, axis=1)).mean()
    path = path_of(error, runs[0], 20.0)
    assert path.time_s[-1] == pytest.approx(60.0, abs=0.02)
