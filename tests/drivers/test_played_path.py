"""A deviation out of a file, played by the simulated cell."""

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from .simulated_bench import PERIOD_NS, QUIET_TRACKER, Bench, quiet

STEP_S, START_S = 0.004, 0.01
ROWS_UM = np.array([5.0, 9.0, -3.0, 40.0, 38.0, 12.0])


def file_of(folder, rows_um=ROWS_UM):
    file = folder / "path.csv"
    lines = [f"{k * STEP_S:.6f},{um!r}" for k, um in enumerate(rows_um.tolist())]
    file.write_text("\n".join(["t_s,deviation_x_um", *lines]) + "\n", encoding="utf-8")
    return str(file)


def played(folder, cycles, **tracker):
    options = {"file": file_of(folder), "start_s": START_S}
    bench = Bench(quiet(deviation=options, tracker={**QUIET_TRACKER, **tracker}))
    rows = bench.record(cycles, "path_error", "true_stage", "deviation")
    return rows[:, 0] + rows[:, 1], rows[:, 2]


def test_a_cubic_runs_through_the_rows_and_stands_still_beyond_them(tmp_path):
    path, _ = played(tmp_path, 400)
    time_s = 1e-9 * PERIOD_NS * np.arange(1, 401) - START_S
    knots = STEP_S * np.arange(len(ROWS_UM))
    around = np.pad(ROWS_UM, 1, "edge")
    expected = CubicHermiteSpline(knots, ROWS_UM, (around[2:] - around[:-2]) / (2.0 * STEP_S))
    np.testing.assert_allclose(path, expected(np.clip(time_s, 0.0, knots[-1])), atol=1e-9)
    assert path[0] == ROWS_UM[0]
    assert path[-1] == ROWS_UM[-1]


def test_the_tracker_sees_the_path_late(tmp_path):
    path, seen = played(tmp_path, 300, rate_Hz=10_000.0, latency_ms=1.0)
    np.testing.assert_allclose(seen[20:], path[10:-10], atol=1e-9)
