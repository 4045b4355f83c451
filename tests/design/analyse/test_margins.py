"""Margins: oracles of `control`, what happens when a margin is used up, and eigenvalues that a good Ms hides."""

import control
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from micromanip.control.margins import curve_margins, grid, margins, within
from micromanip.control.system import System, delay

PERIOD_S = 1e-3


def sampled(numerator, denominator, period_s=PERIOD_S):
    return control.ss(control.sample_system(control.tf(numerator, denominator), period_s, "zoh"))


def of_control(loop):
    """A system of `control` as ours."""
    return System(loop.A, loop.B[:, 0], loop.C[0], float(loop.D[0, 0]), loop.dt)


KNOWN = {
    "three lags": control.tf([24.0], np.poly([-1.0, -2.0, -3.0]).real),
    "integrator and two lags": control.tf([8.0], np.poly([0.0, -4.0, -8.0]).real),
    "conditionally stable": control.tf(2.0 * np.poly([-1.0, -1.0]), np.poly([0.0, 0.0, 0.0, -10.0]).real) * 10.0,
}


@pytest.mark.parametrize("name", KNOWN)
def test_agrees_with_control_on_known_systems(name):
    loop = control.ss(control.sample_system(KNOWN[name], 0.05, "tustin"))
    found = margins(of_control(loop))
    gain, phase, distance, _, _, at = control.stability_margins(loop, epsw=1e-3, method="poly")
    if gain > 1:
        assert found.gain_up == pytest.approx(gain, rel=1e-5)
    else:
        assert found.gain_down == pytest.approx(gain, rel=1e-5)
    assert found.phase_deg == pytest.approx(abs(phase), rel=1e-5)
    # control's is from the roots of a polynomial of high order, so a dense grid has the last word
    dense = np.geomspace(at / 3.0, min(3.0 * at, np.pi / 0.05), 20_001)
    assert found.modulus == pytest.approx(np.abs(1.0 + loop(np.exp(0.05j * dense))).min(), rel=1e-6)
    assert found.modulus == pytest.approx(distance, rel=5e-3)
    assert 2 * np.pi * found.peak_Hz == pytest.approx(at, rel=5e-2)


@given(st.sampled_from(sorted(KNOWN)), st.floats(0.0, 0.4), st.integers(0, 30), st.sampled_from([-1.0, 1.0]))
def test_no_plant_within_what_is_known_has_less(name, share, late, sign):
    loop = of_control(control.ss(control.sample_system(KNOWN[name], 0.05, "tustin")))
    known = within(nominal := margins(loop), loop, lambda w: np.full_like(w, share))
    error = lambda w: sign * share * np.exp(-0.05j * late * w)  # noqa: E731
    found = curve_margins(lambda w: loop.response(w) * (1.0 + error(w)), grid(0.05, loop.poles))
    assert found.modulus >= known.modulus - 1e-3
    assert found.gain_dB >= min(known.gain_dB, 25.0) - 0.1  # the grid is coarse where L is small
    assert known.gain_dB <= max(nominal.gain_dB - 20.0 * np.log10(1.0 + share), 0.0) + 0.1
    assert within(nominal, loop, np.zeros_like).modulus == pytest.approx(nominal.modulus, rel=1e-6)


def test_agrees_with_control_on_a_frequency_response_alone():
    continuous = KNOWN["three lags"]
    found = curve_margins(lambda w: continuous(1j * w), np.geomspace(1e-2, 1e3, 300))
    gain, phase, _, crossing = control.margin(continuous)
    assert found.gain_up == pytest.approx(gain, rel=1e-6)
    assert found.phase_deg == pytest.approx(phase, rel=1e-6)
    assert 2 * np.pi * found.crossovers_Hz[0] == pytest.approx(crossing, rel=1e-6)
    assert np.isnan(found.radius)
    assert not found.stable, "a curve alone does not prove stability"


def resonant(damping):
    """Integrator with a mode at 100 rad/s, whose peak reaches -0.5 however sharp it is."""
    return sampled([damping * 1e6], np.polymul([1.0, 0.0], [1.0, 200.0 * damping, 1e4]))


@pytest.mark.parametrize("damping", [0.05, 1e-3, 1e-5])
def test_a_sharp_resonance_is_seen_however_narrow(damping):
    loop = of_control(resonant(damping))
    found = margins(loop)
    mode = float(np.abs(np.angle(loop.poles)).max() / PERIOD_S)
    near = np.unique(mode + 100.0 * damping * np.linspace(-8, 8, 40_001))
    L = loop.response(near)
    assert found.modulus == pytest.approx(np.abs(1.0 + L).min(), rel=1e-6)
    assert 2 * np.pi * found.peak_Hz == pytest.approx(mode, rel=1e-2)


def random_loop(draw):
    """A stable closed loop: lags, an oscillating mode, a delay, and a gain below the critical one."""
    poles = draw(st.lists(st.floats(0.3, 0.98), min_size=1, max_size=3))
    radius, angle = draw(st.floats(0.7, 0.995)), draw(st.floats(0.1, 2.0))
    zeros = draw(st.lists(st.floats(-0.9, 0.9), min_size=1, max_size=2))
    numerator = np.poly(zeros)
    denominator = np.poly([*poles, radius * np.exp(1j * angle), radius * np.exp(-1j * angle)]).real
    system = of_control(control.ss(control.tf(numerator, denominator, PERIOD_S)))
    peak = np.abs(system.response(grid(PERIOD_S, system.poles))).max()
    return delay(draw(st.integers(0, 2)), PERIOD_S).then(system).scaled(draw(st.floats(0.05, 3.0)) / peak)


loops = st.composite(random_loop)()


def closed_radius(system):
    return np.abs(np.linalg.eigvals(system.closed())).max()


@given(loops)
def test_margins_are_what_can_be_used_up(loop):
    """Just inside a margin the loop is stable, just outside it is not."""
    found = margins(loop)
    assume(found.stable)
    for factor in (f for f in (found.gain_up, found.gain_down) if np.isfinite(f) and f > 1e-6):
        inside, outside = (1.0 + (factor - 1.0) * share for share in (1.0 - 1e-4, 1.0 + 1e-4))
        assert closed_radius(loop.scaled(inside)) < 1.0
        assert closed_radius(loop.scaled(outside)) > 1.0 - 1e-12
    assert closed_radius(loop.scaled(1.0 + 0.5 * (min(found.gain_up, 1e6) - 1.0))) < 1.0


@given(loops)
def test_the_modulus_bounds_the_other_margins(loop):
    """A circle of radius 1/Ms around -1 that is kept free guarantees gain and phase."""
    found = margins(loop)
    Ms = found.sensitivity
    assert found.gain_up >= (Ms / (Ms - 1.0) if Ms > 1.0 else np.inf) - 1e-6 or found.modulus >= 1.0 - 1e-9
    assert found.phase_deg >= np.degrees(2 * np.arcsin(min(1.0, found.modulus / 2.0))) - 1e-4
    assert found.gain_down <= 1.0 / (1.0 + found.modulus) + 1e-6


@given(loops)
def test_the_delay_margin_is_the_lag_at_a_crossover(loop):
    found = margins(loop)
    assume(found.stable and np.isfinite(found.delay_s))
    whole = int(found.delay_s / PERIOD_S)
    assume(whole < 2000)  # a state a cycle
    assert closed_radius(delay(whole, PERIOD_S).then(loop)) < 1.0 + 1e-9
    assert any(
        abs(1.0 + loop.response(np.array([2 * np.pi * f]))[0] * np.exp(-2j * np.pi * f * found.delay_s)) < 1e-6
        for f in found.crossovers_Hz
    )


def test_an_unstable_loop_with_a_good_ms_is_called_unstable():
    """An unstable pole that the loop does not encircle: far from -1 everywhere, and unstable."""
    loop = System(np.array([[1.2]]), np.array([1.0]), np.array([0.05]), 0.0, PERIOD_S)
    found = margins(loop)
    assert found.sensitivity < 1.5
    assert found.gain_dB > 6.0
    assert found.radius == pytest.approx(1.15)
    assert not found.stable


def test_response_is_that_of_control():
    rng = np.random.default_rng(2)
    A = rng.normal(size=(7, 7))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    system = System(A, rng.normal(size=7), rng.normal(size=7), 0.3, PERIOD_S)
    omega = np.geomspace(1.0, np.pi / PERIOD_S, 50)
    theirs = control.ss(system.A, system.B[:, None], system.C[None, :], [[system.D]], PERIOD_S)
    expected = theirs(np.exp(1j * omega * PERIOD_S))
    assert system.response(omega) == pytest.approx(expected, rel=1e-9)
    lagging = delay(3, PERIOD_S).then(system)
    assert lagging.response(omega) == pytest.approx(expected * np.exp(-3j * omega * PERIOD_S), rel=1e-9)
