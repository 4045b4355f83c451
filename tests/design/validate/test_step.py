"""The step of the stage: its course, and what is read off an answer to it."""

import numpy as np
import pytest

from micromanip.design.validate.step import RISE_S, STEP_UM, course, judge_step

T_S = np.arange(-2000, 5000) * 1e-4


def test_the_course_begins_and_ends_at_rest():
    w = course(T_S)
    assert (w[T_S <= 0.0] == 0.0).all()
    assert w[T_S >= RISE_S] == pytest.approx(STEP_UM, abs=1e-12)
    assert (np.diff(w) >= 0.0).all()
    assert np.abs(np.diff(w)).max() * 1e4 == pytest.approx(0.5 * np.pi * STEP_UM / RISE_S, rel=1e-3)


@pytest.mark.parametrize("damping", [0.1, 0.4])
def test_the_closed_form_of_a_second_order_lag(damping):
    """Overshoot exp(-pi d / sqrt(1 - d^2)); the envelope exp(-d w t) is 5 % when it has settled."""
    omega, root = 2.0 * np.pi * 60.0, np.sqrt(1.0 - damping**2)
    t = np.maximum(T_S, 0.0)
    swing = np.cos(omega * root * t) + damping / root * np.sin(omega * root * t)
    stage = np.where(T_S > 0.0, STEP_UM * (1.0 - np.exp(-damping * omega * t) * swing), 0.0)
    answer = judge_step(T_S, stage)
    assert answer.overshoot == pytest.approx(np.exp(-np.pi * damping / root), rel=1e-2)
    envelope_s = np.log(1.0 / (0.05 * root)) / (damping * omega)
    assert envelope_s - np.pi / (omega * root) <= answer.settling_s <= envelope_s


def test_noise_is_neither_overshoot_nor_unrest():
    noisy = course(T_S) + np.random.default_rng(1).normal(0.0, 0.2, len(T_S))
    answer = judge_step(T_S, np.clip(noisy, course(T_S) - 0.79, course(T_S) + 0.79), 0.2)
    assert (answer.overshoot, answer.band_um) == (0.0, pytest.approx(0.8))
    assert answer.settling_s < RISE_S
    assert judge_step(T_S, noisy).overshoot > 0.05
