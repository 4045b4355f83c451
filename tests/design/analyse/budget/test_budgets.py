"""The budget of a run: its causes are those that the simulation has, and their sum is the whole."""

from pathlib import Path

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.design.analyse.budget.budget import FORCE, TRACKER
from micromanip.design.analyse.budget.recorded import (
    ACTUATOR,
    MISSED,
    UNEXPLAINED,
    played_budget,
    recorded_budget,
)
from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.rt.states import READY
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment, with_options

SECONDS = 14.0


def silent(what):
    pass


@pytest.fixture(scope="module")
def prepared():
    return prepare(CONFIG / "simulated.yaml")


def tracked(prepared, wait_s, seconds):
    cell = VirtualExperiment(prepared, process=True).cell(prepared.configuration, prepared.samples)
    cell.arm()
    cell.run(wait_s)
    return cell.run(seconds)


@pytest.fixture(scope="module")
def rows(prepared):
    return tracked(prepared, 4.0, 6.0)


def recording(prepared, rows, **changed):
    """What `run --record` would have written of these rows."""
    rows = rows.copy()
    for name, value in changed.items():
        (rows if name in rows.dtype.names else rows["axis"])[name] = value
    names, period_ns = list(prepared.configuration.axes), prepared.configuration.loop.period_ns
    return Telemetry.of_rows(Path("run.mcap"), names, period_ns, rows, prepared.source.text)


def by_name(budget):
    return {cause["name"]: cause["rms_um"] for cause in budget.document()["causes"]}


def of(prepared, **changed):
    """The budget of axis y of the cell with some options changed."""
    cell = prepared.wiring.options["cell"]
    options = cell.model_copy(update={k: getattr(cell, k).model_copy(update=each) for k, each in changed.items()})
    return played_budget(with_options(prepared, "cell", options), ["y"], SECONDS, 1.0, silent)[0]


@pytest.mark.long
def test_a_cause_goes_when_what_causes_it_does(prepared):
    whole = of(prepared)
    calm, quiet = of(prepared, force={"tooth_N": 0.0, "noise_N": 0.0}), of(prepared, tracker={"noise_um": 0.05})
    assert by_name(whole)[UNEXPLAINED] < 0.06 * whole.rms_um
    assert by_name(whole)[ACTUATOR] < 0.1 * whole.rms_um
    assert by_name(calm)[FORCE] < 0.03 * by_name(whole)[FORCE]
    assert by_name(calm)[TRACKER] == pytest.approx(by_name(whole)[TRACKER], rel=0.03)
    assert by_name(quiet)[TRACKER] < 0.2 * by_name(whole)[TRACKER]
    assert by_name(quiet)[FORCE] == pytest.approx(by_name(whole)[FORCE], rel=0.03)
    for budget in (whole, calm, quiet):
        assert budget.bound.rms_um < budget.rms_um
        assert sum(cause.variance_um2 for cause in budget.causes) == pytest.approx(budget.variance_um2)
        assert all((cause.power >= 0.0).all() for cause in budget.causes)


@pytest.mark.long
def test_the_whole_of_a_recording_is_its_mean_square(prepared, rows):
    (found,) = recorded_budget(recording(prepared, rows), ["x"], 1.0, silent)
    error = rows["axis"]["path_error_um"][20_001:-10_001, 0]
    assert found.variance_um2 == pytest.approx(np.mean(error**2), rel=0.01)


@pytest.mark.long
def test_what_no_law_explains_is_said_so_and_put_down_to_missed_cycles_where_there_are_some(prepared, rows):
    struck, kept = rows.copy(), np.ones(len(rows), dtype=bool)
    struck["axis"]["setpoint_um"][30_040:30_090, 0] += 5.0
    kept[30_000:30_040] = False
    plain, missed = (
        by_name(recorded_budget(recording(prepared, each), ["x"], 1.0, silent)[0]) for each in (struck, struck[kept])
    )
    assert plain[MISSED] == 0.0
    assert plain[UNEXPLAINED] > 0.1
    assert missed[MISSED] > 0.8 * plain[UNEXPLAINED]
    assert missed[UNEXPLAINED] < 0.5 * missed[MISSED]


def test_recordings_that_show_no_path_error_are_refused(prepared):
    rows = np.zeros(50_000, dtype=VirtualExperiment(prepared).cell(prepared.configuration).run(0.001).dtype)
    rows["cycle"] = np.arange(50_000)
    with pytest.raises(CheckFailed, match=r"run\.mcap: the cell does not track"):
        recorded_budget(recording(prepared, rows, state=READY), ["x"], 1.0, silent)


def test_what_is_no_simulated_cell_with_a_tracker_is_refused(prepared, monkeypatch):
    with pytest.raises(CheckFailed, match=r"factory\.yaml: what ran followed no tracker"):
        played_budget(prepare(CONFIG / "factory.yaml"), ["x"], SECONDS, 1.0, silent)
    monkeypatch.setattr(type(prepared.wiring.drivers["cell"]), "virtual", False)
    with pytest.raises(CheckFailed, match=r"simulated\.yaml: only a simulated cell is played"):
        played_budget(prepared, ["x"], SECONDS, 1.0, silent)
