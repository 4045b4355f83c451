"""What a closed outer loop is measured by: the set-point moves as asked, whatever the regulator."""

import numpy as np
import pytest

from micromanip.control.outer_gains import outer_gains
from micromanip.design.identify.closed_loop_response import reference_for
from micromanip.settings.schema.axis import LinearModel, Outer

RATE_HZ, DELAY = 10_000.0, 3
MODE = np.exp(2 * np.pi * 55.0 * (-0.01 + 1j) / RATE_HZ)


@pytest.mark.parametrize("weight", [0.1, 30.0, 1000.0])
def test_the_model_in_the_loop_moves_the_set_point_as_asked(weight):
    A = ((MODE.real, -MODE.imag), (MODE.imag, MODE.real))
    model = LinearModel(A=A, B=(0.0, 1.0), C=(-5.0 * abs(1 - MODE) ** 2 / MODE.imag, 0.0), delay_cycles=DELAY)
    gains = outer_gains(Outer(model=model, control_weight=weight), None, 1.0 / RATE_HZ)
    controllable = 2 + DELAY
    A, B, K = gains.A[:controllable, :controllable], gains.B[:controllable], gains.feedback[:controllable]
    wanted = np.zeros(20_000)
    wanted[2000:12_000] = np.convolve(np.random.default_rng(2).normal(size=10_000), np.hanning(9), "same")
    w = reference_for(wanted, gains, controllable, RATE_HZ)
    fed = gains.reference[0] * w + gains.reference[1] * RATE_HZ * np.gradient(w)
    x, given = np.zeros(controllable), np.zeros(len(wanted))
    for k in range(len(wanted)):
        given[k] = fed[k] - K @ x
        x = A @ x + B * given[k]
    assert given[10:-10] == pytest.approx(wanted[10:-10], abs=0.02)
