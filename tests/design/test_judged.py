"""The strain loop is judged with the PID that runs, not with the one that is written."""

from types import SimpleNamespace

import numpy as np
import pytest

from micromanip.design.judged import analyse_strain
from micromanip.design.loops import System, margins, strain_loop
from micromanip.settings.schema.axis import Axis
from micromanip.settings.wiring.timing import AT_ONCE

PLANT = System(np.array([[0.8, 0.0], [0.13, 0.8]]), np.array([0.13, 0.0]), np.array([0.0, 1.0]), 0.0, 1e-4)


def axis(mode):
    return Axis.model_validate(
        {
            "mode": mode,
            "centre_um": 60.0,
            "setpoint": {"range_um": [2.0, 128.0], "slew_um_per_ms": 30.0},
            "hysteresis": {"model": "pi", "range_um": [2, 128], "thresholds_um": [3.5], "weights": [0.08]}
            | {"shaping": "affine", "coefficients": [0.63, 0.0]},
            "inner": {"mode": "pid+feedforward", "K_V_per_um": 0.4, "Ti_ms": 0.3, "Td_ms": 0.05, "filter_ms": 0.02},
            "actuator": {"delay_us": 190.0, "feedback_percent": 80.0},
            "outer": None,
        }
    )


def test_the_share_of_the_feedback_that_is_left_is_what_is_judged():
    seen = SimpleNamespace(system=PLANT, dynamics=PLANT, delay=0, path=AT_ONCE, swing_um=20.0, centre_V=60.0)
    running = axis("strain")
    found = analyse_strain(running, seen, None)
    weaker = running.inner.model_copy(update={"K_V_per_um": 0.8 * running.inner.K_V_per_um})
    for slope, judged in zip(found.slopes, found.margins, strict=True):
        assert judged.sensitivity == pytest.approx(margins(strain_loop(weaker, PLANT, slope)).sensitivity)
        assert judged.sensitivity != pytest.approx(
            margins(strain_loop(running.inner, PLANT, slope)).sensitivity, rel=1e-3
        )
    assert found.side.inner == weaker
