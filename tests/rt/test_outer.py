"""Gains of the outer loop: against control and filterpy, and what they achieve in the model."""

import control
import numpy as np
import pytest

from micromanip.control.gain_schedule import calm_gains
from micromanip.control.predictor import reference_transition
from micromanip.rt.laws.estimator import ESTIMATOR_STATE, MAX_STATES
from micromanip.rt.laws.reference import REFERENCE_PARAMETERS, REFERENCE_STATE, REFERENCE_STATES, extrapolate
from micromanip.settings.schema.reference import AxisDeviation, Oscillation, Tracker

from .builders import PERIOD_S, record
from .kernels import outer_course
from .outer_loops import designed, process_noise

TRACKER = Tracker(
    source="signal",
    oscillation_Hz=8.0,
    axes={
        "y": AxisDeviation(
            oscillations=(
                Oscillation(frequency_Hz=8.0, um_per_s=60.0),
                Oscillation(frequency_Hz=21.0, um_per_s=60.0),
                Oscillation(frequency_Hz=1.0, um_per_s=60.0, decay_per_s=0.4),
            )
        )
    },
)
MOVED = {"x": [(8.0, 0.0)], "y": [(8.0, 0.0), (21.0, 0.0), (1.0, 0.4)]}
VARIANTS = [(0, None), (0, 200.0), (2, None), (2, 200.0), (5, 180.0)]
variants = pytest.mark.parametrize(("delay", "oscillation_Hz"), VARIANTS)


def split(settings, gains):
    """Controllable part and, on it, what the disturbances do."""
    n = len(settings.model.A) + settings.model.delay_cycles
    return gains.A[:n, :n], gains.B[:n], gains.C[:n], n


@variants
def test_model_is_the_given_one_with_delay_and_disturbances(delay, oscillation_Hz):
    """Impulse responses of the augmented model, from the set-point and from each disturbance."""
    settings, gains, _ = designed(delay, oscillation_Hz=oscillation_Hz)
    a, b, c = (np.array(m) for m in (settings.model.A, settings.model.B, settings.model.C))
    plain = [c @ np.linalg.matrix_power(a, k) @ b for k in range(80)]

    def response(x):
        y = []
        for _ in range(60):
            y.append(gains.C @ x)
            x = gains.A @ x
        return np.array(y)

    # set-point: B at cycle 0 is seen `delay` + 1 cycles later
    assert response(gains.B)[delay:] == pytest.approx(plain[: 60 - delay], abs=1e-10)
    assert response(gains.B)[:delay] == pytest.approx(0.0)
    walk = np.zeros(len(gains.A))
    walk[len(a) + delay] = 1.0
    assert response(walk)[1:] == pytest.approx(np.cumsum(plain)[:59], abs=1e-10)
    if oscillation_Hz is not None:
        swing = np.zeros(len(gains.A))
        swing[-2] = 1.0
        wave = np.cos(2 * np.pi * oscillation_Hz * PERIOD_S * np.arange(60))
        assert response(swing)[1:] == pytest.approx(np.convolve(wave, plain)[:59], abs=1e-9)


@variants
def test_feedback_is_dlqr(delay, oscillation_Hz):
    settings, gains, _ = designed(delay, oscillation_Hz=oscillation_Hz, control_weight=3.0)
    A, B, C, n = split(settings, gains)
    K, _, poles = control.dlqr(A, B[:, None], np.outer(C, C), np.array([[3.0]]))
    assert gains.feedback[:n] == pytest.approx(np.asarray(K)[0], rel=1e-6, abs=1e-8)
    assert np.sort(np.abs(np.linalg.eigvals(A - np.outer(B, gains.feedback[:n])))) == pytest.approx(
        np.sort(np.abs(poles)),
        rel=1e-4,
        abs=1e-3,  # delay poles at 0 are badly conditioned
    )


@variants
def test_observer_is_dlqe(delay, oscillation_Hz):
    settings, gains, _ = designed(delay, oscillation_Hz=oscillation_Hz)
    n = len(gains.A)
    noise = process_noise(settings, gains) + 1e-12 * np.eye(n)
    L, _, _ = control.dlqe(gains.A, np.eye(n), gains.C[None, :], noise, np.array([[settings.sensor_noise_um**2]]))
    # dlqe's is the gain of the predictor: the correction, one cycle on
    assert gains.A @ gains.observer == pytest.approx(np.asarray(L)[:, 0], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("sample_cycles", [1, 10])
@variants
def test_closed_loop_poles_are_those_of_the_whole_loop(delay, oscillation_Hz, sample_cycles):
    """Plant and estimator together in one matrix: its eigenvalues are A - B K's and the observer's."""
    settings, gains, _ = designed(delay, oscillation_Hz=oscillation_Hz, sample_cycles=sample_cycles)
    A, B, _, n = split(settings, gains)
    poles = gains.closed_loop_poles
    assert np.abs(poles).max() < 1.0
    regulator = np.linalg.eigvals(A - np.outer(B, gains.feedback[:n]))
    assert np.sort(np.abs(poles[:n])) == pytest.approx(np.sort(np.abs(regulator)))
    if sample_cycles > 1:
        return
    N, F = len(gains.A), gains.A
    correct = np.eye(N) - np.outer(gains.observer, gains.C)
    # states: plant, and the estimate after its correction
    whole = np.block(
        [
            [F, -np.outer(gains.B, gains.feedback)],
            [np.outer(gains.observer, gains.C) @ F, correct @ F - np.outer(gains.B, gains.feedback)],
        ]
    )
    eigenvalues = np.linalg.eigvals(whole)
    # the disturbances themselves, on the unit circle, are no part of the loop
    outside = np.linalg.eigvals(F[n:, n:])
    expected = np.concatenate([poles, outside])
    for value in expected:
        if abs(value) > 0.3:  # delay poles at 0 are badly conditioned
            assert np.abs(eigenvalues - value).min() < 1e-4
    assert np.abs(eigenvalues).max() < 1.0 + 1e-6


REFERENCES = {
    "constant": [20.0, 0.0, 0.0, 0.0, 0.0],
    "ramp": [20.0, 150.0, 0.0, 0.0, 0.0],
    "parabola": [-20.0, 150.0, 400.0, 0.0, 0.0],
    "oscillation": [0.0, 0.0, 0.0, 30.0, 500.0],
    "all": [10.0, -100.0, 300.0, 10.0, -900.0],
    "three oscillations": [10.0, -100.0, 300.0, 10.0, -900.0, 5.0, 100.0, -40.0, 20.0],
}


STILL = record(REFERENCE_STATE)
"""None of them is followed."""


def moved(axis):
    """The oscillations of `axis`, written down once more."""
    omegas, decays = ([factor * each[i] for each in MOVED[axis]] for i, factor in ((0, 2 * np.pi), (1, 1.0)))
    return record(REFERENCE_PARAMETERS, modes=len(omegas), oscillator=omegas, decay=decays)


def state(name):
    return np.pad(REFERENCES[name], (0, REFERENCE_STATES - len(REFERENCES[name])))


@pytest.mark.long
@pytest.mark.many_cycles
@pytest.mark.parametrize("reference", REFERENCES)
@pytest.mark.parametrize(("delay", "oscillation_Hz"), [(0, None), (2, 200.0), (5, 180.0)])
def test_references_are_followed_and_disturbances_cancelled(delay, oscillation_Hz, reference):
    """To 1e-6 um after the transient, by the very code that runs in the loop."""
    axis = "x" if len(REFERENCES[reference]) == 5 else "y"
    _, gains, p = designed(delay, TRACKER.of(axis), oscillation_Hz=oscillation_Hz, oscillation_um=0.01)
    n = len(gains.A)
    plant = np.zeros(MAX_STATES)
    walk = n - 3 if oscillation_Hz is not None else n - 1
    plant[walk] = 4.0  # um at the set-point
    if oscillation_Hz is not None:
        plant[-(len(plant) - n) - 2] = 2.0
    w, scratch, out = state(reference), np.zeros(REFERENCE_STATES), np.zeros((4000, 3))
    outer_course(p, record(ESTIMATOR_STATE), plant, scratch, w, moved(axis), STILL, PERIOD_S, out)
    error = out[:, 0] - out[:, 1]
    assert np.abs(error[:200]).max() > 1.0  # there was something to do
    assert np.abs(error[-500:]).max() < 1e-6
    assert np.ptp(out[-500:, 2]) > (1e-3 if reference != "constant" or oscillation_Hz else -1.0)


def test_the_calm_gains_are_of_the_same_cost_with_more_weight_and_leave_no_error():
    """Oracle: python-control's discrete Riccati equation; the closed loop's gain from a position that is held is 1."""
    for delay, oscillation_Hz in VARIANTS:
        settings, gains, _ = designed(delay, oscillation_Hz=oscillation_Hz)
        feedback, following = calm_gains(settings, gains, None, PERIOD_S)
        n = gains.controllable
        A, B, C = gains.A[:n, :n], gains.B[:n, None], gains.C[:n]
        K, _, poles = control.dlqr(A, B, np.outer(C, C), 30.0 * settings.control_weight)
        assert feedback[:n] == pytest.approx(K[0], rel=1e-6, abs=1e-9)
        assert np.abs(poles).max() < 1.0
        closed = np.linalg.solve(np.eye(n) - A + B @ feedback[None, :n], B[:, 0])
        assert C @ closed * following[0] == pytest.approx(1.0)
        # a disturbance that is held is cancelled: u = -w moves nothing
        assert np.abs(feedback[:n]).max() < np.abs(gains.feedback[:n]).max()
        w = np.zeros(len(gains.A))
        w[n] = 1.0
        state = np.linalg.solve(np.eye(n) - A + B @ feedback[None, :n], gains.A[:n, n] - B[:, 0] * feedback[n])
        assert C @ state == pytest.approx(0.0, abs=1e-9)


def test_reference_transition_is_that_of_extrapolate():
    w, out = state("three oscillations"), np.zeros(REFERENCE_STATES)
    extrapolate(moved("y"), STILL["detuning"], w, PERIOD_S, out)
    assert out == pytest.approx(reference_transition(TRACKER.of("y").oscillations, PERIOD_S) @ w)
