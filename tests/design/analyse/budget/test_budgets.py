"""Budgets of a configuration and of a recording: the same causes, and the sum is the whole."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from micromanip.design.analyse.budget.causes import FORCE, PREDICTION, STAGE, TRACKER
from micromanip.design.analyse.budget.configured import HYSTERESIS, SATURATION, budget_of, cell_of
from micromanip.design.analyse.budget.recorded import ACTUATOR, MISSED, UNEXPLAINED, recorded_budget
from micromanip.errors import CheckFailed
from micromanip.recordings import Telemetry
from micromanip.rt.states import READY
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment, with_options

CONFIG = Path(__file__).parents[4] / "config"
SECONDS = 4.0


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


@pytest.mark.long
def test_a_configuration_and_its_run_have_the_same_budget(prepared):
    """Of 12 s, after the predictors have learned: in 6 s the tracker's noise scatters by a fifth."""
    (computed,) = budget_of(prepared, ["y"], SECONDS, 1, 1.0, silent)
    (recorded,) = recorded_budget(recording(prepared, tracked(prepared, 8.0, 12.0)), ["y"], 1.0, silent)
    assert computed.measured_um == pytest.approx(computed.rms_um, rel=0.1)
    first, second = by_name(computed), by_name(recorded)
    assert {HYSTERESIS, SATURATION} <= first.keys()
    for cause, rel in ((TRACKER, 0.15), (FORCE, 0.15), (PREDICTION, 0.25)):
        assert second[cause] == pytest.approx(first[cause], rel=rel), cause
    # the narrow predictor of the recording knew of samples from before it, and takes 5 s to forget them
    assert second[UNEXPLAINED] < 0.12 * recorded.rms_um
    assert second[ACTUATOR] < 0.15 * recorded.rms_um
    for budget in (computed, recorded):
        assert budget.bound.rms_um < budget.rms_um
        assert sum(cause.variance_um2 for cause in budget.causes) == pytest.approx(budget.variance_um2)
        assert all((cause.power >= 0.0).all() for cause in budget.causes)
    quieter = [each.rms_um for each in computed.variants if each.what.startswith("tracker noise ")]
    assert quieter[0] < computed.rms_um < quieter[-1]


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


@pytest.mark.long
def test_of_a_real_cell_only_what_the_configuration_says_is_budgeted(prepared, monkeypatch):
    (simulated,) = budget_of(prepared, ["x"], SECONDS, 1, 1.0, silent)
    real = type(prepared.wiring.drivers["cell"])
    monkeypatch.setattr(real, "simulated_axis", lambda self, name: None)
    monkeypatch.setattr(real, "simulated", False)
    (found,) = budget_of(prepared, ["x"], SECONDS, 1, 1.0, silent)
    assert by_name(found).keys() == {TRACKER, STAGE}
    said = prepared.configuration.reference.of("x").noise_um / prepared.wiring.options["cell"].tracker.noise_um
    assert by_name(found)[TRACKER] == pytest.approx(said * by_name(simulated)[TRACKER], rel=0.05)
    assert found.bound is None
    assert found.measured_um is None
    assert "of a real cell does not hold them; a recording shows them" in found.unknown[0]


@pytest.mark.parametrize(("noise_um", "believed"), [(0.5, True), (2.0, False)])
def test_a_narrow_predictor_that_its_tracker_belies_is_not_budgeted(prepared, noise_um, believed):
    """Samples beyond six of the stated sigma make it begin anew, several times a second."""
    cell = prepared.wiring.options["cell"]
    noisy = with_options(
        prepared, "cell", cell.model_copy(update={"tracker": cell.tracker.model_copy(update={"noise_um": noise_um})})
    )
    assert (cell_of(noisy, "x").laws.tracker.steady is not None) == believed


def test_configurations_without_a_tracker_of_the_axes_are_refused(prepared):
    with pytest.raises(CheckFailed, match=r"factory\.yaml: .*reference\.source is .*, it must be signal"):
        cell_of(prepare(CONFIG / "factory.yaml"), "x")
    turned = prepared.configuration.reference.model_copy(update={"frame": "a frame"})
    configuration = prepared.configuration.model_copy(update={"reference": turned})
    with pytest.raises(CheckFailed, match=r"reference\.frame: .*trackers that read the axes themselves"):
        cell_of(replace(prepared, configuration=configuration), "x")
