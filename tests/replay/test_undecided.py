"""Decisions that a recording does not tell: whether the tooth's observer is given up, how far an outrun axis goes."""

import numpy as np
import pytest

from micromanip.replay.counterfactual import Outcome, Rerun, predict
from micromanip.replay.fitting import fit_models
from micromanip.replay.window import take_window
from micromanip.rt.states import TOOTH_LOST

from .recorded import track
from .tuned import tuned

GIVEN_UP = 1 << TOOTH_LOST


@pytest.fixture(scope="module")
def rerun(recorded):
    cell, telemetry = recorded
    window = take_window(telemetry)
    return Rerun(window, fit_models(window, cell.configuration))


def observing(cell, oscillation_um):
    """Axis x follows the tooth, with an observer as hot as is said; the rest of it is calm, whatever the cell's is."""
    outer = {
        "oscillation_Hz": 200.0,
        "oscillation_range_percent": 3.0,
        "oscillation_um": oscillation_um,
        "control_weight": 24.0,
        "disturbance_um": 0.03,
        "sensor_noise_um": 0.018,
        "input_noise_um": 0.5,
    }
    return tuned(cell, {f"axes.x.outer.{key}": value for key, value in outer.items()})


def truly(cell, rerun, parameters):
    """Figures and outcome of the same cell simulated anew."""
    return rerun.outcome(track(cell, parameters, window=rerun.window))


@pytest.mark.compiled_only
@pytest.mark.long
def test_where_the_observer_may_be_given_up_the_range_holds_both(recorded, rerun):
    """Near the border both observers are simulated anew, one that stays and one that is given up."""
    cell, _ = recorded
    stays, lost = 1e-3, 1.0
    assert not rerun.outcome(rerun.rows(observing(cell, stays))).conditions[0] & GIVEN_UP
    assert rerun.outcome(rerun.rows(observing(cell, lost))).conditions[0] & GIVEN_UP
    for _ in range(12):
        middle = float(f"{np.sqrt(stays * lost):.5g}")
        given_up = rerun.outcome(rerun.rows(observing(cell, middle))).conditions[0] & GIVEN_UP
        stays, lost = (stays, middle) if given_up else (middle, lost)
    found = predict(rerun, observing(cell, lost), draws=12)
    (told,) = [each for each in found.undecided if each.code == "W-216"]
    assert (told.axis, told.expected) == ("x", True)
    assert 0 < told.models < told.of
    ends = [truly(cell, rerun, observing(cell, factor * um)) for factor, um in ((0.7, stays), (1.5, lost))]
    assert [bool(each.conditions[0] & GIVEN_UP) for each in ends] == [False, True]
    for each in ends:
        assert found.expected.low_um[0, 0] <= 1.02 * each.um[0, 0]
        assert found.expected.high_um[0, 0] >= each.um[0, 0]
    truth = truly(cell, rerun, observing(cell, lost)).um
    assert (found.expected.low_um[:, 0] <= truth[:, 0]).all()
    assert (truth[:, 0] <= found.expected.high_um[:, 0]).all()


@pytest.mark.compiled_only
@pytest.mark.long
@pytest.mark.parametrize(
    "values",
    [{"inner.Td_ms": 0.0}, {"setpoint.slew_um_per_ms": 1.0}, {"inner.Ti_ms": 0.3}],
    ids=lambda values: next(iter(values)),
)
def test_the_truth_is_within_the_range(recorded, rerun, values):
    """Next to nothing changes; or the set-point is too slow; or the strain loop is quite another one."""
    cell, _ = recorded
    parameters = tuned(cell, {f"axes.{axis}.{key}": value for axis in "xyz" for key, value in values.items()})
    expected = predict(rerun, parameters, draws=6).expected
    truth = truly(cell, rerun, parameters).um
    assert (expected.low_um <= truth).all()
    assert (truth <= expected.high_um).all()
    if "setpoint.slew_um_per_ms" in values:
        assert np.isinf(expected.high_um).any()
    if "inner.Td_ms" in values:
        assert np.isfinite(expected.high_um).all()
    assert (expected.low_um > 0.0).all()


def outcome(um, conditions=0, counted=0, stopped=False):
    return Outcome(np.full((3, 1), um), np.array([conditions]), np.array([counted]), stopped)
