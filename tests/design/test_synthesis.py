"""Both syntheses hold what they promise, judged by `control`, and refuse what they cannot hold."""

import control
import numpy as np
import pytest

from micromanip.control.margins import margins
from micromanip.control.outer_gains import outer_gains
from micromanip.design.loops import System, delay, model_system, stage_loop, strain_loop
from micromanip.design.paper import ANCHOR_PID
from micromanip.design.synthesis import tune_outer, tune_pid
from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import LinearModel

pytestmark = pytest.mark.long

T = 1e-4
SLOPES = (0.75, 1.0, 1.3)


def lag(gain, hertz, late):
    """A first-order actuator behind `late` cycles."""
    pole = np.exp(-2 * np.pi * hertz * T)
    return delay(late, T).then(System(np.array([[pole]]), np.array([1 - pole]), np.array([gain]), 0.0, T))


def swinging(hertz=66.0, damping=0.02, gain=5.0, late=2):
    """The stage: one mode behind a delay."""
    s = 2 * np.pi * hertz * (-damping + 1j * np.sqrt(1 - damping**2))
    z = np.exp(s * T)
    A = np.array([[z.real, -z.imag], [z.imag, z.real]])
    B = np.array([0.0, 1.0])
    C = np.array([1.0, 0.0])
    C = C * gain / float(C @ np.linalg.solve(np.eye(2) - A, B))
    return LinearModel(A=tuple(map(tuple, A.tolist())), B=tuple(B), C=tuple(C.tolist()), delay_cycles=late)


@pytest.mark.parametrize("gain", [0.3, 0.65, 2.0])
def test_the_pid_has_its_margins_at_every_slope(gain):
    actuator = lag(gain, 900.0, 1)
    design = tune_pid(ANCHOR_PID, actuator, SLOPES)
    for slope in SLOPES:
        loop = strain_loop(design.inner, actuator, slope).state_space()
        gain_margin, phase_deg, modulus, *_ = control.stability_margins(loop)
        assert gain_margin >= 10 ** (4.0 / 20)
        assert phase_deg >= 35.0
        assert 1.0 / modulus <= design.sensitivity + 1e-3 <= 2.2
        assert np.abs(control.feedback(loop).poles()).max() < 1.0
    assert design.residual_10Hz < 0.1  # what feedback is for


def test_the_tuning_scales_with_the_actuator():
    one, three = (tune_pid(ANCHOR_PID, lag(gain, 900.0, 1), SLOPES).inner for gain in (1.0, 3.0))
    assert three.K_V_per_um == pytest.approx(one.K_V_per_um / 3.0, rel=1e-2)  # a search, not a formula
    assert three.Ti_ms == pytest.approx(one.Ti_ms, rel=1e-2)


def test_more_delay_leaves_less_feedback():
    residuals = [tune_pid(ANCHOR_PID, lag(0.65, 900.0, late), SLOPES).residual_10Hz for late in (0, 4, 16)]
    assert residuals == sorted(residuals)
    assert residuals[-1] > 2.0 * residuals[0]


def test_what_no_pid_can_hold_is_refused():
    """A resonance without damping, of either sign at once, in the middle of the band."""
    s = 2 * np.pi * 150.0 * (-1e-4 + 1j)
    z = np.exp(s * T)
    A = np.array([[z.real, -z.imag], [z.imag, z.real]])
    mode = System(A, np.array([0.0, 1.0]), np.array([30.0, 0.0]), 0.0, T)
    with pytest.raises(CheckFailed, match="no PID keeps the sensitivity below"):
        tune_pid(ANCHOR_PID, delay(60, T).then(mode), SLOPES)


def test_the_outer_loop_has_its_margins():
    model = swinging()
    design = tune_outer(model, T, 0.012)
    assert design.margins.gain_dB >= 6.0
    assert design.margins.phase_deg >= 35.0
    gains = outer_gains(design.outer, None, T)
    again = margins(stage_loop(gains, model_system(model, T)))
    assert again.stable
    assert again.gain_dB == pytest.approx(design.margins.gain_dB)
    assert np.abs(gains.closed_loop_poles).max() < 1.0
    efforts, bandwidths = [entry[0] for entry in design.tried], [entry[1] for entry in design.tried]
    assert design.outer.control_weight == pytest.approx(
        min(e for e in efforts if e >= 0.99 * design.outer.control_weight), rel=1e-3
    )
    assert bandwidths[0] > 2.0 * bandwidths[-1]  # the knob turns something


def test_bandwidth_is_a_knob():
    model = swinging()
    fast, calm = tune_outer(model, T, 0.012), tune_outer(model, T, 0.012, bandwidth_Hz=120.0)
    assert calm.bandwidth_Hz == pytest.approx(120.0, rel=0.2)
    assert calm.bandwidth_Hz < fast.bandwidth_Hz
    with pytest.raises(CheckFailed, match="no outer loop at 2000 Hz"):
        tune_outer(model, T, 0.012, bandwidth_Hz=2000.0)


def test_too_much_delay_is_refused_with_the_best_there_is():
    runaway = LinearModel(A=((1.06,),), B=(1.0,), C=(1.0,), delay_cycles=8)
    with pytest.raises(CheckFailed, match=r"the best has -?[\d.]+ dB and \d+ deg"):
        tune_outer(runaway, T, 0.012)
