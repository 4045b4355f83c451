"""What the first travel and a small step show of stage sensor and flexure, on records whose truth is known."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from micromanip.design.commission.stage_sensor_check import check_travel, judge_answer, require_centred
from micromanip.errors import CheckFailed
from micromanip.recordings import TimeSeries

RATE_HZ = 10_000
AXIS = SimpleNamespace(setpoint=SimpleNamespace(range_um=(2.0, 128.0)), centre_um=66.0)
CELL = SimpleNamespace(axes={"x": AXIS})


def record(lost_um=0.0, zero_um=0.0):
    """A shrinking triangle; the stage is five times the gauge, behind a play of `lost_um` and `zero_um` off."""
    strain = 66.0 + np.interp(np.arange(6000), np.arange(0, 6001, 500), 60.0 * (-0.95) ** np.arange(13))
    stage, held = np.zeros(len(strain)), 5.0 * (strain[0] - 66.0)
    for k, free in enumerate(5.0 * (strain - 66.0)):
        held = min(max(held, free - 0.5 * lost_um), free + 0.5 * lost_um)
        stage[k] = held
    columns = {"voltage_V": strain, "strain_um": strain, "stage_um": stage + zero_um}
    return TimeSeries.of_columns(Path("axis x"), columns, 1e-3)


def test_a_little_lost_motion_is_borne_and_more_is_named():
    """About the working point the stage travels some 190 um, of which 5 % may be lost."""
    assert check_travel(CELL, "x", record(4.0), {}).slope == pytest.approx(5.0, rel=0.01)
    with pytest.raises(CheckFailed, match=r"axis x: where the actuator turns the stage stays \d+ um behind.*loose"):
        check_travel(CELL, "x", record(20.0), {})


def test_a_stage_sensor_with_another_zero_is_named_before_a_loop_is_closed():
    """It reads the position from the end of its travel; the path would begin at an end of the set-point's range."""
    travel = check_travel(CELL, "x", record(zero_um=100.0), {})  # 20 um of the gauge, of 62 on either side
    assert travel.slope == pytest.approx(5.0)
    require_centred(CELL, "x", travel)
    with pytest.raises(
        CheckFailed, match=r"reads 300.0 um where the gauge reads centre_um, 66 um, .* shift its zero by 300.0 um"
    ):
        require_centred(CELL, "x", check_travel(CELL, "x", record(zero_um=300.0), {}))


def answer(mode_Hz, tau_s, damping=0.02):
    rows = np.zeros(6000, [("strain_um", "f8"), ("stage_um", "f8")])
    t = (np.arange(6000) - 1000) / RATE_HZ
    after = np.maximum(t, 0.0)
    rows["strain_um"] = 60.0 + 3.0 * (1.0 - np.exp(-after / tau_s))
    swing = np.cos(2 * np.pi * mode_Hz * after) * np.exp(-damping * 2 * np.pi * mode_Hz * after)
    rows["stage_um"] = np.where(t > 0.0, 15.0 * (1.0 - swing), 0.0)
    rows["stage_um"] += np.random.default_rng(1).normal(0.0, 0.01, 6000)
    return judge_answer(rows, 1000, RATE_HZ)


@pytest.mark.parametrize("mode_Hz", [8.0, 19.0, 40.0, 67.0])
def test_the_swing_after_a_step_is_told_by_its_frequency(mode_Hz):
    assert answer(mode_Hz, 1e-3).swing_Hz == pytest.approx(mode_Hz, abs=1.0)


@pytest.mark.parametrize("tau_ms", [1.0, 5.0, 20.0])
def test_the_time_for_63_percent_is_that_of_the_lag(tau_ms):
    assert answer(67.0, 1e-3 * tau_ms).rise_ms == pytest.approx(tau_ms, abs=0.2)
