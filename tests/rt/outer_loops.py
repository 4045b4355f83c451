"""Outer loops for the tests: a plant written down here, not the fitted one of the configuration."""

import numpy as np
from scipy.linalg import block_diag, expm

from micromanip.control.outer_gains import outer_gains
from micromanip.rt.laws.estimator import GAPS, in_blocks
from micromanip.rt.laws.lqg import OUTER_PARAMETERS
from micromanip.settings.compile.limits import NEVER
from micromanip.settings.schema.axis import LinearModel, Outer

from .builders import PERIOD_S, record


def linear_model(delay_cycles=2):
    """Stage over set-point: gain 5, flexure at 66 Hz with damping 0.012, inner loop of 300 Hz."""
    omega, damping, pole = 2 * np.pi * 66.0, 0.012, 2 * np.pi * 300.0
    # the inner loop drives the flexure; velocities in units of omega keep the states alike in size
    A = np.array([[-pole, 0.0, 0.0], [0.0, 0.0, omega], [5.0 * omega, -omega, -2 * damping * omega]])
    B = np.array([pole, 0.0, 0.0])
    block = np.zeros((4, 4))
    block[:3, :3], block[:3, 3] = A, B
    step = expm(block * PERIOD_S)
    return LinearModel(
        A=tuple(tuple(map(float, row)) for row in step[:3, :3]),
        B=tuple(map(float, step[:3, 3])),
        C=(0.0, 1.0, 0.0),
        delay_cycles=delay_cycles,
    )


def outer(delay_cycles=2, **knobs):
    return Outer(model=linear_model(delay_cycles), **knobs)


def parameters(gains, /, **changed):
    """The loop's record of these gains; the filter believes every sample, unless that is `changed`."""
    n = len(gains.A)
    fields = {
        "states": n,
        "a_blocks": in_blocks(gains.A),
        "b": gains.B,
        "c": gains.C,
        "gains": np.tile(gains.observer, (GAPS, 1)),
        "feedback": gains.feedback,
        "reference_states": len(gains.reference),
        "reference": gains.reference,
        "steady_u": gains.steady_u,
        "steady_y": gains.steady_y,
        "innovation_um": np.inf,
        "repeated_um": np.inf,
        "gap_cycles": NEVER,
    }
    return record(OUTER_PARAMETERS, **fields | changed)


def designed(delay_cycles=2, tracker=None, **knobs):
    """Settings, gains and the loop's record."""
    settings = outer(delay_cycles, **knobs)
    gains = outer_gains(settings, tracker, PERIOD_S)
    return settings, gains, parameters(gains)


def process_noise(settings, gains):
    """Covariance of the noise a cycle, from the settings' description."""
    _n, delay = len(settings.model.A), settings.model.delay_cycles
    b = np.array(settings.model.B)
    oscillator = [settings.oscillation_um**2] * 2 if settings.oscillation_Hz is not None else []
    Q = block_diag(
        settings.input_noise_um**2 * np.outer(b, b),
        np.zeros((delay, delay)),
        settings.disturbance_um**2,
        np.diag(oscillator),
    )
    assert Q.shape == gains.A.shape
    return Q
