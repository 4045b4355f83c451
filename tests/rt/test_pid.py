"""PID (17) with filtered derivative and back-calculation."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.rt.laws.pid import pid_output, retune, start_pid, unwind

from .builders import PERIOD_S, courses, pid, pid_state
from .kernels import pid_course, saturated_course

K, TI_S, TD_S, TF_S = 0.6, 0.571e-3, 0.167e-3, 0.3e-3
ERRORS = st.floats(-50.0, 50.0)


def along(p, s, error, periods=1):
    out = np.zeros(len(error))
    pid_course(p, s, np.asarray(error, dtype=float), periods, out)
    return out


def measured_response(p, frequency_Hz, step_s, periods=1):
    """Gain and phase as a complex number, from a sine put through it."""
    n = round(max(20.0 / frequency_Hz, 0.02) / step_s)
    angle = 2 * np.pi * frequency_Hz * step_s * np.arange(n)
    out = along(p, pid_state(), np.sin(angle), periods)
    late = slice(n // 2, None)  # the derivative's filter has settled; the integrator keeps an offset
    basis = np.column_stack([np.sin(angle), np.cos(angle), np.ones(n)])[late]
    sine, cosine, _ = np.linalg.lstsq(basis, out[late], rcond=None)[0]
    return sine + 1j * cosine


def discrete(step_s):
    """Backward Euler of (17) as a transfer function of z."""
    z = control.TransferFunction.z
    z.dt = step_s
    return K * (1 + step_s / TI_S * z / (z - 1) + TD_S * (z - 1) / ((TF_S + step_s) * z - TF_S))


@pytest.mark.parametrize("frequency_Hz", [3.0, 50.0, 400.0, 1500.0, 4500.0])
@pytest.mark.parametrize("periods", [1, 4])
def test_measured_transfer_function(frequency_Hz, periods):
    step_s = periods * PERIOD_S
    if frequency_Hz > 0.45 / step_s:
        frequency_Hz /= 4.0
    expected = discrete(step_s)(np.exp(2j * np.pi * frequency_Hz * step_s))
    assert measured_response(pid(), frequency_Hz, step_s, periods) == pytest.approx(expected, rel=1e-6)


@given(courses(ERRORS), st.integers(1, 50))
def test_periods_are_one_exact_backward_euler_step(error, periods):
    """A step over m cycles is a step of a PID whose period is m times as long."""
    slow = pid(period_s=periods * PERIOD_S)
    assert along(pid(), pid_state(), error, periods) == pytest.approx(
        along(slow, pid_state(), error), rel=1e-9, abs=1e-9
    )


@given(courses(ERRORS), st.integers(1, 50), st.integers(1, 50))
def test_of_missing_samples_the_integral_counts_so_many_periods(error, periods, most):
    """Proportional and derivative part are those of the whole step."""
    counted, whole = (
        along(pid(most_periods=most), pid_state(), error, periods),
        along(pid(), pid_state(), error, periods),
    )
    left_out = (periods - min(periods, most)) * pid()["integral"]
    assert counted == pytest.approx(whole - left_out * np.cumsum(error), rel=1e-9, abs=1e-6)


@given(st.floats(0.01, 1.9), st.integers(2, 200))
def test_a_sensor_that_misses_samples_leaves_a_stable_loop_stable(gain, periods):
    """Integral action on a plant without memory: what bears twice the gain bears any gap."""
    p, s, plant_um_per_V = pid(Td_s=0.0, K=1e-9, most_periods=2), pid_state(), 1.0
    p["integral"] = 0.5 * gain / plant_um_per_V
    y = 0.0
    for _ in range(2000):
        y = plant_um_per_V * pid_output(p, s, 1.0 - y, periods)
    assert abs(1.0 - y) < 1e-6


# -- anti-windup --------------------------------------------------------------------------------------

LOW_V, HIGH_V = -20.0, 150.0


def saturated(p, reference):
    """Columns y (um), u (V) and integrator, around a plant of 0.9 um/V and 1 ms with a limited input."""
    out = np.zeros((len(reference), 3))
    saturated_course(
        p, pid_state(), np.asarray(reference, dtype=float), 0.9, np.exp(-PERIOD_S / 1e-3), LOW_V, HIGH_V, out
    )
    return out


def test_recovers_from_saturation_without_overshoot():
    """200 um can't be reached; back at 60 um the loop with tracking forgets that, the one without does not."""
    reference = np.concatenate([np.full(2000, 200.0), np.full(2000, 60.0)])
    tracked, naive = saturated(pid(tracking=0.1), reference), saturated(pid(tracking=0.0), reference)
    assert tracked[1999, 1] == naive[1999, 1] == HIGH_V
    after = slice(2000 + 100, None)  # 10 ms after the step back
    assert np.abs(tracked[after, 0] - 60.0).max() < 0.5
    assert np.abs(naive[after, 0] - 60.0).max() > 50.0
    assert tracked[-1, 0] == pytest.approx(60.0, abs=1e-6)


def test_integrator_is_bounded_in_saturation():
    p = pid(tracking=0.1)
    out = saturated(p, np.full(20_000, 1000.0))
    error = 1000.0 - 0.9 * HIGH_V
    # at rest the back-calculation takes what the integral adds: tracking * excess = integral * error
    excess = p["integral"] * error / p["tracking"]
    assert out[-1, 2] == pytest.approx(HIGH_V + excess - p["K_V_per_um"] * error - p["tracking"] * excess, rel=1e-6)
    assert np.abs(out[:, 2]).max() < 2.0 * (HIGH_V + excess + p["K_V_per_um"] * error)
    naive = saturated(pid(tracking=0.0), np.full(20_000, 1000.0))
    assert naive[-1, 2] > 100.0 * np.abs(out[:, 2]).max()


@given(st.floats(0.0, 1.0), st.floats(-1e3, 1e3))
def test_unwind_takes_its_share_of_the_excess(tracking, excess):
    s = pid_state(integrator=5.0)
    unwind(pid(tracking=tracking), s, excess)
    assert s["integrator"] == 5.0 - tracking * excess


# -- bumpless -----------------------------------------------------------------------------------------


@given(ERRORS, st.floats(-150.0, 150.0))
def test_bumpless_start(error, output_V):
    p, s = pid(), pid_state(integrator=9.0, derivative=9.0, error=9.0, output_V=9.0)
    start_pid(p, s, error, output_V)
    assert s["output_V"] == output_V
    first = pid_output(p, s, error, 1)
    assert first == pytest.approx(output_V + p["integral"] * error, rel=1e-9, abs=1e-9)


@given(courses(ERRORS), st.floats(0.05, 3.0), st.floats(0.0, 1e-3), st.floats(0.0, 1e-3))
def test_bumpless_retune(error, gain, Td_s, filter_s):
    """At the same error the new PID goes on from the old output, but for its integral and the filter's decay."""
    old, new = pid(), pid(K=gain, Td_s=Td_s, filter_s=filter_s)
    s = pid_state()
    before = along(old, s, error)[-1]
    retune(old, new, s)
    held = s["derivative"]
    after = pid_output(new, s, error[-1], 1)
    decayed = held * (1.0 - filter_s / (filter_s + PERIOD_S))
    assert after == pytest.approx(before + new["integral"] * error[-1] - decayed, rel=1e-9, abs=1e-8)
