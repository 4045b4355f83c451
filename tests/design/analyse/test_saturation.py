"""Loops that a slew limit keeps swinging: what the model says of their gains, and what catches them in the cell."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from campaigns.report import CONFIG
from micromanip.control.outer_gains import outer_gains
from micromanip.design.analyse.saturation import Reach, Samples, comes_to_rest
from micromanip.design.commission.limit_cycle import stage_at_rest, strain_at_rest
from micromanip.design.experiment import with_axis
from micromanip.rt.states import LIMIT_CYCLE, NO_FAULT
from micromanip.settings.check import prepare
from micromanip.settings.compile.cell import compile_cell
from micromanip.virtual.cell import VirtualCell
from micromanip.virtual.experiment import VirtualExperiment

CELL = prepare(CONFIG / "simulated.yaml")
PERIOD_S = 1e-4
AS_IT_IS, NERVOUS = (
    {},
    {"control_weight": 0.4217, "input_noise_um": 1.0, "disturbance_um": 0.0555, "oscillation_um": 0.001755},
)
"""The second has all its margins: Ms 1.86, 7.8 dB and 37 degrees on its own model."""


def with_outer(options):
    outer = CELL.configuration.axes["x"].outer.model_copy(update=options)
    return with_axis(CELL.configuration, "x", outer=outer)


def rests(options, slew_um=2.0, range_um=63.0):
    outer = with_outer(options).axes["x"].outer
    return comes_to_rest(outer_gains(outer, None, PERIOD_S), len(outer.model.A), Reach(slew_um, range_um), PERIOD_S)


def test_a_calm_loop_comes_to_rest_and_a_nervous_one_does_not():
    assert rests(AS_IT_IS)
    assert not rests(NERVOUS)


@pytest.mark.parametrize(("residue", "calm"), [(1e-4, True), (0.5, False)])
def test_a_pole_with_a_zero_upon_it_is_no_mode_that_swings(residue, calm):
    """An identification leaves such pairs; nobody can damp one, and nothing can raise it. One that moves counts."""
    outer = CELL.configuration.axes["x"].outer
    model, turn = outer.model, 2.0 * np.pi * 23.7 * PERIOD_S
    pair = 0.999999 * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    raised = residue * np.array([0.0, turn]) * float(np.abs(model.C).max())
    model = model.model_copy(
        update={
            "A": tuple(map(tuple, block_diag(model.A, pair))),
            "B": (*model.B, *raised),
            "C": (*model.C, 1.0, 0.0),
        }
    )
    gains = outer_gains(outer.model_copy(update={"model": model, "control_weight": 1e3}), None, PERIOD_S)
    assert comes_to_rest(gains, len(model.A), Reach(2.0, 63.0), PERIOD_S) is calm


SELDOM = prepare(CONFIG / "simulated_2khz.yaml")
SWINGS = {"control_weight": 0.05623, "input_noise_um": 0.001, "disturbance_um": 7.208e-05, "oscillation_um": 7.208e-06}
"""Ms 1.61, 9.6 dB and 52 degrees on its own model; the stage swings by 10 um rms for ever."""


@pytest.mark.parametrize(("options", "calm"), [({}, True), (SWINGS, False)])
def test_a_loop_whose_samples_come_seldom_and_late_is_judged_as_well(options, calm):
    """By the model; and in the cell, whose swing at rest is not taken for its noise."""
    axis = SELDOM.configuration.axes["x"]
    outer, experiment = axis.outer.model_copy(update=options), VirtualExperiment(SELDOM)
    path = experiment.path(SELDOM.configuration, "x")
    samples, reach = Samples(outer.sample_cycles, path.stage_late), Reach.of(axis, PERIOD_S)
    assert samples.cycles == 5
    assert comes_to_rest(outer_gains(outer, None, PERIOD_S), len(outer.model.A), reach, PERIOD_S, samples) is calm
    tuned = with_axis(SELDOM.configuration, "x", outer=outer)
    strain, inner = strain_at_rest(tuned, experiment, "x")
    assert not strain.swings
    rest = stage_at_rest(tuned, experiment, "x", inner)
    assert rest.swings is not calm
    assert rest.floor_um < 0.3
    if not calm:
        assert 25.0 < rest.line_Hz < 60.0
        assert rest.line_um > 5.0


def test_a_set_point_that_may_go_fast_lets_both_come_to_rest():
    assert rests(NERVOUS, slew_um=1e3)
    assert rests(NERVOUS, range_um=1.0), "a small reach is a small swing"


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "calm", "fault"), [(AS_IT_IS, True, NO_FAULT), (NERVOUS, True, NO_FAULT), (NERVOUS, False, LIMIT_CYCLE)]
)
def test_the_simulated_cell_does_the_same_after_a_stall_unless_calm_gains_catch_it(options, calm, fault):
    """It stands still for 2.5 ms eight times, with the tool in the cut: hysteresis, sensors and all."""
    cell = VirtualCell(compile_cell(with_outer(options), CELL.wiring), CELL.wiring)
    outer = cell.parameters[0]["axis"]["outer"]
    if not calm:
        outer["far_feedback"], outer["far_reference"] = outer["feedback"], outer["reference"]
        cell.parameters[0]["axis"]["fallback"] = cell.parameters[0]["axis"]["pid"]
    cell.arm()
    cell.run(3.0)
    for _ in range(8):
        cell.run(0.1013)
        cell.run(0.08, periods=26)
    assert cell.state[0]["fault"] == fault
    if fault == NO_FAULT:
        error_um = cell.run(0.2)["axis"]["path_error_um"][:, 0]
        assert np.sqrt(np.mean(error_um**2)) < 3.0
