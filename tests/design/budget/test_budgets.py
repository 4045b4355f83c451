"""Budgets of a configuration and of a recording: the same causes, and the sum is the whole."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from campaigns.budget import compared
from micromanip.cli.commission import _budgeted
from micromanip.design.budget.causes import FORCE, PREDICTION, STAGE, TRACKER
from micromanip.design.budget.configured import HYSTERESIS, SATURATION, budget_of, cell_of
from micromanip.design.budget.recorded import ACTUATOR, DISTURBANCE, MISSED, UNEXPLAINED, recorded_budget
from micromanip.errors import CheckFailed, UsageError
from micromanip.recordings import Telemetry
from micromanip.rt.states import READY
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment, with_options
from micromanip.virtual.switched import NOISE, play_without

CONFIG = Path(__file__).parents[3] / "config"
SECONDS = 4.0


def silent(what):
    pass


@pytest.fixture(scope="module")
def prepared():
    return prepare(CONFIG / "simulated.yaml")


@pytest.fixture(scope="module")
def rows(prepared):
    cell = VirtualExperiment(prepared, process=True).cell(prepared.configuration, prepared.samples)
    cell.arm()
    cell.run(4.0)
    return cell.run(6.0)


def recording(prepared, rows, **changed):
    """What `run --record` would have written of these rows."""
    rows = rows.copy()
    for name, value in changed.items():
        (rows if name in rows.dtype.names else rows["axis"])[name] = value
    names, period_ns = list(prepared.configuration.axes), prepared.configuration.loop.period_ns
    return Telemetry.of_rows(Path("run.mcap"), names, period_ns, rows, prepared.source.text)


def by_name(budget):
    return {cause["name"]: cause["rms_um"] for cause in budget.document()["causes"]}


@pytest.mark.thorough  # what is computed beside what is recorded: the next test
def test_computed_causes_are_what_switching_them_off_takes_away(prepared):
    """4 s of 1/f-like noise know a variance to some 15 %; the campaign `budget` plays 30 s of five cells."""
    for axis, cause, computed, played in compared(prepared, SECONDS, seed=3):
        if played > 0.1:
            assert computed == pytest.approx(played, rel=0.15), (axis, cause)


@pytest.mark.long
def test_a_configuration_and_its_run_have_the_same_budget(prepared, rows):
    (computed,) = budget_of(prepared, ["y"], SECONDS, 1, 1.0, silent)
    (recorded,) = recorded_budget(recording(prepared, rows), ["y"], 1.0, silent)
    assert computed.measured_um == pytest.approx(computed.rms_um, rel=0.1)
    first, second = by_name(computed), by_name(recorded)
    assert {HYSTERESIS, SATURATION} <= first.keys()
    for cause, rel in ((TRACKER, 0.15), (FORCE, 0.15), (PREDICTION, 0.25)):  # of 4 s, in which it hardly repeats
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
def test_a_trial_through_a_real_loop_is_budgeted_by_its_own_rows(prepared, rows):
    copied = rows.copy()
    copied[30_000:30_040] = copied[29_999]  # the loop skipped 40 cycles
    found = _budgeted(prepared, 1, prepared.configuration, copied, virtual=False)
    assert [budget.axis for budget in found] == list("xyz")
    seen = rows["axis"]["path_error_um"][20_001:-10_001]
    for i, budget in enumerate(found):
        assert budget.variance_um2 == pytest.approx(np.mean(seen[:, i] ** 2), rel=0.05)
        assert by_name(budget).keys() >= {FORCE, TRACKER, MISSED}


@pytest.mark.long
def test_without_what_only_a_simulation_knows_force_and_actuator_are_one(prepared, rows):
    hidden = recording(prepared, rows, true_stage_um=np.nan, path_error_um=np.nan, uncompensated_um=np.nan)
    (found,), (known,) = (recorded_budget(r, ["z"], 1.0, silent) for r in (hidden, recording(prepared, rows)))
    shown, truth = by_name(found), by_name(known)
    assert FORCE not in shown
    assert shown[DISTURBANCE] == pytest.approx(np.hypot(truth[FORCE], truth[ACTUATOR]), rel=0.15)
    assert shown[TRACKER] == pytest.approx(truth[TRACKER], rel=0.15)
    assert shown[STAGE] < 0.05
    assert found.rms_um == pytest.approx(known.rms_um, rel=0.03), "not less for the noise that the smoothed path has"
    assert "smoothed" in found.notes[0]


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


def test_only_a_simulation_has_causes_to_switch_off(prepared):
    with pytest.raises(ValueError, match="nothing to switch off is called rain"):
        play_without(prepared, ("rain",), 1.0, 1)
    assert set(NOISE) > {"force"}
    other = prepare(CONFIG / "can.yaml")
    with pytest.raises(UsageError, match="only the driver simulated"):
        play_without(other, (), 1.0, 1)
