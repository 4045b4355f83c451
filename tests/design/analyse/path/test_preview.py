"""The preview beside the truth: drawn paths, played; what the tracker saw in a recording as a path."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from campaigns.path import compare
from micromanip.design.analyse.path.seen import recorded_path
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import DEVIATION_FRESH
from micromanip.settings.check import prepare

CONFIG = Path(__file__).parents[4] / "config"


@pytest.mark.long
@pytest.mark.parametrize(("seed", "verdict"), [(2, "fits"), (9, "does not fit")])
def test_the_verdict_holds_where_the_path_is_played(tmp_path, seed, verdict):
    found = compare(prepare(CONFIG / "simulated.yaml"), seed, tmp_path)
    assert (found.verdict, found.agreed) == (verdict, True), found.said


@dataclass
class Recorded:
    """As much of a recording as a path takes of it."""

    values: dict
    axes: tuple = ("x", "y")
    file: Path = Path("run.mcap")

    def column(self, path):
        return self.values[path]

    def columns(self, *paths):
        return {path: self.values[path] for path in paths}


def recording(cycles=4000, every=10, age_ns=1_000_000):
    """10 kHz rows of a tracker that is fresh in each tenth, 1 ms late."""
    at = np.arange(cycles)
    fresh = np.where(at % every == 3, DEVIATION_FRESH, 0)
    taken_s = (at - (at - 3) % every) * 1e-4 - 1e-9 * age_ns
    columns = {"time_ns": 7_000_000_000 + at * 100_000, "state": np.full(cycles, TRACKING)}
    for k, hertz in enumerate((1.0, 2.0)):
        columns |= {
            f"axis.{k}.fresh": fresh | 1,
            f"axis.{k}.deviation_age_ns": np.full(cycles, float(age_ns)),
            f"axis.{k}.deviation_um": 100.0 * np.sin(2.0 * np.pi * hertz * taken_s),
        }
    return Recorded(columns)


def test_what_the_tracker_saw_counts_when_it_was_taken():
    path = recorded_path(recording(), ["y", "x"])
    assert path.even_step_s() == pytest.approx(1e-3)
    first_s = 3e-4 - 1e-3
    for column, hertz in zip(path.deviation_um.T, (2.0, 1.0), strict=True):
        np.testing.assert_allclose(column, 100.0 * np.sin(2.0 * np.pi * hertz * (path.time_s + first_s)), atol=1e-6)
