"""The preview beside the truth: drawn paths, played; what the tracker saw in a recording as a path."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from micromanip.design.analyse.path.preview import RANGE, RESERVE, Demand, Stretch, beyond, slow_part, stretches
from micromanip.design.analyse.path.seen import recorded_path
from micromanip.errors import UsageError
from micromanip.rt.states import TRACKING
from micromanip.rt.telemetry import DEVIATION_FRESH
from micromanip.settings.check import prepare

from .played_path import ABOUT_S, hard_stretches, narrowed

RATE_HZ = 1000.0
TIME_S = np.arange(2000) / RATE_HZ


def test_a_stretch_is_where_the_limit_is_crossed_and_by_how_much():
    ramps = Demand(RANGE, "um", 100.0 * np.abs(TIME_S - 1.0) - 50.0, -30.0, 30.0)  # beyond: to .2, .8 to 1.2, from 1.8
    first, middle, last = stretches("x", ramps, RATE_HZ)
    assert (first.from_s, first.asked, first.limit, first.over) == (0.0, 50.0, 30.0, 20.0)
    assert first.to_s == pytest.approx(0.2, abs=2e-3)
    assert (middle.from_s, middle.to_s) == pytest.approx((0.8, 1.2), abs=2e-3)
    assert (middle.asked, middle.limit, middle.over) == (-50.0, -30.0, 20.0)
    assert (last.from_s, last.to_s) == pytest.approx((1.8, 2.0), abs=2e-3)


def test_a_reserve_is_told_where_it_leads_to_no_more():
    def of(what, from_s, to_s):
        return Stretch("x", what, from_s, to_s, 1.0, 0.0, 1.0, "um")

    hard, around = of(RANGE, 1.0, 2.0), of(RESERVE, 0.98, 2.1)
    before, alone = of(RESERVE, 0.7, 2.1), of(RESERVE, 3.0, 3.5)
    assert beyond([hard, around, before, alone]) == [hard, before, alone]


def test_the_offset_is_the_slow_part_without_delay_and_half_of_what_lies_at_its_corner():
    rate_hz, corner_hz = 200.0, 0.2
    time_s = np.arange(round(100.0 * rate_hz)) / rate_hz
    slow, corner, fast = (np.sin(2.0 * np.pi * hertz * time_s) for hertz in (0.01, corner_hz, 8.0))
    path = np.column_stack([100.0 * slow + 20.0 * corner + 30.0 * fast])
    offset = slow_part(["x"], path, rate_hz, corner_hz)
    middle = slice(len(time_s) // 4, 3 * len(time_s) // 4)
    taken = offset.at(time_s)[middle, 0]
    np.testing.assert_allclose(taken, (100.0 * slow + 10.0 * corner)[middle], atol=0.3)
    assert offset.speed_um_per_s == pytest.approx(2.0 * np.pi * (100.0 * 0.01 + 10.0 * corner_hz), rel=0.05)


def test_an_offset_is_written_as_it_is_run_and_replaces_nothing(tmp_path):
    path = np.column_stack([50.0 * np.sin(TIME_S), 20.0 * np.cos(TIME_S)])
    offset = slow_part(["x", "q"], path, RATE_HZ, 1.0)
    file = tmp_path / "offset.csv"
    offset.write(file)
    assert file.read_text(encoding="utf-8").startswith("t_s,offset_x_um,offset_q_um\n")
    rows = np.loadtxt(file, delimiter=",", skiprows=1)
    np.testing.assert_allclose(rows[:, 1:], offset.offset_um, atol=6e-4)
    assert (rows[0, 0], rows[-1, 0]) == (0.0, TIME_S[-1])
    with pytest.raises(UsageError, match="is there already: nothing is replaced"):
        offset.write(file)


CONFIG = Path(__file__).parents[4] / "config"


@pytest.mark.long
def test_on_a_path_that_fits_no_limit_is_met(tmp_path):
    over, _, met_s = hard_stretches(prepare(CONFIG / "simulated.yaml"), 2, tmp_path)
    assert not over
    assert not len(met_s)


@pytest.mark.long
def test_the_first_limit_is_met_where_the_verdict_says(tmp_path):
    over, (first, *_), met_s = hard_stretches(narrowed(prepare(CONFIG / "simulated.yaml")), 9, tmp_path)
    assert ((met_s >= first.from_s - ABOUT_S) & (met_s <= first.to_s + ABOUT_S)).any()
    assert met_s[0] >= first.from_s - ABOUT_S or any(each.from_s < first.from_s for each in over)


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
