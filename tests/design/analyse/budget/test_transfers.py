"""Variances by spectra beside covariances by Lyapunov equations, and the loop's transfers beside steps of its laws."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_lyapunov

from campaigns.report import CONFIG
from micromanip.control.predictor import output_row, reference_transition, tracker_gain
from micromanip.design.analyse.budget.budget import Grid, prediction_variance, shared_out
from micromanip.design.analyse.budget.loop import AxisLaws
from micromanip.design.analyse.budget.tracking import Tracking
from micromanip.errors import CheckFailed
from micromanip.settings.load import load
from micromanip.settings.schema.reference import Oscillation, Tracker

SIMULATED = CONFIG / "simulated.yaml"


@pytest.fixture(scope="module")
def laws():
    found = load(SIMULATED)
    return AxisLaws("x", found.axes["x"], replace(found.reference.of("x"), steady=None), 1e-4)


TWO = (Oscillation(frequency_Hz=7.8, um_per_s=3.0), Oscillation(frequency_Hz=0.9, um_per_s=20.0, decay_per_s=0.5))


def closed_model(laws):
    """A, B (n,) of r, B of the sensor's noise, C of the closed loop around the configured model, as it is stepped."""
    outer, gains = laws.axis.outer, laws.gains
    n, m = len(outer.model.A), len(gains.A)
    d = outer.model.delay_cycles
    A, r, noise = np.zeros((n + d + m,) * 2), np.zeros(n + d + m), np.zeros(n + d + m)
    C = np.concatenate([outer.model.C, np.zeros(d + m)])
    corrected = np.eye(m) - np.outer(gains.observer, gains.C)
    from_seen = -gains.feedback @ gains.observer
    u_x = np.concatenate([from_seen * C[: n + d], -gains.feedback @ corrected])
    A[:n, :n], A[:n, n + d - 1] = outer.model.A, outer.model.B
    A[n] = u_x
    A[n + 1 : n + d, n : n + d - 1] = np.eye(d - 1)
    A[n + d :, : n + d] = gains.A @ np.outer(gains.observer, C[: n + d])
    A[n + d :, n + d :] = gains.A @ corrected
    A[n + d :] += np.outer(gains.B, u_x)
    r[n], r[n + d :] = 1.0, gains.B
    noise[n], noise[n + d :] = from_seen, gains.A @ gains.observer + gains.B * from_seen
    return A, r, noise, C


def test_sensor_noise_is_what_the_lyapunov_equation_says(laws):
    A, _, noise, C = closed_model(laws)
    P = solve_discrete_lyapunov(A, np.outer(noise, noise) * 0.012**2)
    grid = Grid(10_000.0)
    loop = laws.around(laws.model(grid.omega), grid.omega)
    assert grid.white(loop.of_stage_noise, 0.012**2).sum() == pytest.approx(C @ P @ C, rel=1e-4)


@pytest.mark.parametrize(("every", "latency_s", "modes"), [(10, 1e-3, 1), (20, 0.7e-3, 1), (1, 0.0, 1), (10, 1e-3, 2)])
def test_tracker_noise_is_what_the_lifted_lyapunov_equation_says(laws, every, latency_s, modes):
    """The predictor's state changes at samples, the loop's in each cycle: one period of both is time-invariant."""
    own = TWO if modes == 2 else laws.tracker.oscillations
    tracker = replace(laws.tracker, sample_rate_Hz=1e4 / every, oscillations=own)
    laws = replace(laws, tracker=tracker)
    tracking = Tracking(tracker, every, latency_s, 1e-4)
    A, r, _, C = closed_model(laws)
    n, r_states = len(A), 3 + 2 * modes
    scale = np.array([1.0, 50.0, 2500.0, 1.0, 50.0, 1.0, 6.0])[:r_states]
    step = reference_transition(own, every * 1e-4) * scale / scale[:, None]
    gain = tracker_gain(tracker) / scale
    taken = [laws.gains.reference @ reference_transition(own, latency_s + j * 1e-4) * scale for j in range(every)]
    arriving = np.eye(n + r_states)
    arriving[n:, n:] = (np.eye(r_states) - np.outer(gain, output_row(r_states))) @ step
    entering = np.concatenate([np.zeros(n), gain])
    cycles = []
    for row in taken:
        cycle = np.eye(n + r_states)
        cycle[:n, :n], cycle[:n, n:] = A, np.outer(r, row)
        cycles.append(cycle)
    whole = arriving
    for cycle in cycles:
        whole = cycle @ whole
    driven = np.linalg.multi_dot([*reversed(cycles), entering]) if every > 1 else cycles[0] @ entering
    P = solve_discrete_lyapunov(whole, np.outer(driven, driven) * 0.25)
    P = arriving @ P @ arriving.T + 0.25 * np.outer(entering, entering)
    read, variance = np.concatenate([C, np.zeros(r_states)]), 0.0
    for cycle in cycles:
        variance += read @ P @ read / every
        P = cycle @ P @ cycle.T
    grid = Grid(10_000.0)
    loop = laws.around(laws.model(grid.omega), grid.omega)
    through = loop.followed * tracking.response(laws.gains.reference, grid.omega)
    found = grid.white(through, 0.25 / every).sum()
    assert found == pytest.approx(variance, rel=2e-3)


def test_the_bound_is_the_conditional_variance_of_a_gaussian_process():
    def r(lags_s):
        cosines = 180.0 * np.cos(6.0 * np.pi * lags_s) + 20.0 * np.cos(22.0 * np.pi * lags_s)
        return cosines * np.exp(-0.5 * (lags_s / 0.2) ** 2)

    hertz, power = np.array([3.0, 7.0, 11.0]), np.array([180.0, 0.0, 20.0])
    found = prediction_variance(hertz, power, 0.2, 0.25, 1e-2, np.array([0.02]))
    times = -1e-2 * np.arange(60)
    K, k = r(times[:, None] - times), r(0.02 - times)
    assert found == pytest.approx(200.0 - k @ np.linalg.solve(K + 0.25 * np.eye(60), k), rel=1e-6)


@given(st.lists(st.lists(st.floats(0.0, 1e3), min_size=4, max_size=4), min_size=1, max_size=5), st.floats(0.0, 1e4))
def test_shares_sum_to_the_whole_and_none_is_negative(alone, whole):
    powers = {f"cause {k}": np.array(each) for k, each in enumerate(alone)}
    shares = shared_out(np.full(4, whole), powers)
    assert {each.name for each in shares} == powers.keys()
    assert all((each.power >= 0.0).all() for each in shares)
    np.testing.assert_allclose(np.sum([each.power for each in shares], axis=0), whole, rtol=1e-12, atol=1e-300)


def test_an_axis_without_a_model_of_its_stage_or_behind_a_bus_is_refused():
    for outer, mode, said in (
        (None, "strain", r"axis x: a budget needs the model of its stage.*commission"),
        (SimpleNamespace(sample_cycles=10), "stage", r"axis x: its stage is measured every 10 cycles"),
    ):
        with pytest.raises(CheckFailed, match=said):
            AxisLaws("x", SimpleNamespace(outer=outer, mode=mode), Tracker(source="signal").of("x"), 1e-4)
