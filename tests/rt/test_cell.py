"""State machine of the cell, and what its axes do on the way."""

import math

import numpy as np
import pytest

from micromanip.rt.faults import axis_fault, cell_fault
from micromanip.rt.laws.move import minimum_jerk
from micromanip.rt.laws.saturation import limit
from micromanip.rt.states import (
    ARM,
    ARMING,
    COASTING,
    DEGRADED,
    DISARM,
    DRIVER_ERROR,
    FAULT,
    HOLD,
    HOLDING,
    NO_COMMAND,
    NO_FAULT,
    NOT_FINITE,
    OFF,
    RAMPING,
    READY,
    RESET,
    STAGE_INVALID,
    STOP,
    STRAIN_INVALID,
    STRAIN_SILENT,
    TRACKING,
)

from .bench_cell import BenchCell, X, Y, Z, parameters, tracking


def ready():
    cell = BenchCell()
    cell.run(5)
    return cell


def armed():
    cell = ready()
    assert cell.step(ARM)
    cell.run(20)
    return cell


def holding():
    cell = tracking()
    assert cell.step(HOLD)
    cell.run(100)
    return cell


def fading(command=DISARM):
    cell = tracking()
    assert cell.step(command)
    cell.run(10)
    return cell


def ramping(command=DISARM):
    cell = fading(command)
    cell.run(40)
    return cell


def faulting():
    cell = tracking()
    cell_fault(cell.p, cell.s, DRIVER_ERROR, True, 7.0, 0.0)
    cell.run(10)
    return cell


def fault():
    cell = faulting()
    cell.run(150)
    return cell


def off():
    cell = ready()
    assert cell.step(STOP)
    return cell


FADING, TO_READY, TO_OFF, TO_FAULT = ((RAMPING, after) for after in ("fading", READY, OFF, FAULT))
FADING_TO_OFF = (RAMPING, "fading to OFF")
REFUSED = False
TABLE = {
    # from: (how to get there, what it is, {command: the state after it, or that it is refused})
    "OFF": (off, OFF, {ARM: REFUSED, DISARM: REFUSED, STOP: OFF, RESET: REFUSED, HOLD: REFUSED}),
    "READY": (ready, READY, {ARM: ARMING, DISARM: READY, STOP: OFF, RESET: REFUSED, HOLD: REFUSED}),
    "ARMING": (armed, ARMING, {ARM: REFUSED, DISARM: TO_READY, STOP: TO_OFF, RESET: REFUSED, HOLD: REFUSED}),
    "TRACKING": (
        tracking,
        TRACKING,
        {ARM: REFUSED, DISARM: FADING, STOP: FADING_TO_OFF, RESET: REFUSED, HOLD: HOLDING},
    ),
    "HOLDING": (holding, HOLDING, {ARM: ARMING, DISARM: TO_READY, STOP: TO_OFF, RESET: REFUSED, HOLD: HOLDING}),
    "fading": (fading, FADING, {ARM: REFUSED, DISARM: REFUSED, STOP: FADING_TO_OFF, RESET: REFUSED, HOLD: REFUSED}),
    "RAMPING to READY": (
        ramping,
        TO_READY,
        {ARM: REFUSED, DISARM: REFUSED, STOP: TO_OFF, RESET: REFUSED, HOLD: REFUSED},
    ),
    "RAMPING to OFF": (
        lambda: ramping(STOP),
        TO_OFF,
        {ARM: REFUSED, DISARM: REFUSED, STOP: TO_OFF, RESET: REFUSED, HOLD: REFUSED},
    ),
    "RAMPING to FAULT": (
        faulting,
        TO_FAULT,
        {ARM: REFUSED, DISARM: REFUSED, STOP: TO_OFF, RESET: REFUSED, HOLD: REFUSED},
    ),
    "FAULT": (fault, FAULT, {ARM: REFUSED, DISARM: REFUSED, STOP: OFF, RESET: READY, HOLD: REFUSED}),
}


def where(cell):
    s = cell.s
    if s["state"] != RAMPING:
        return int(s["state"])
    if s["soft"]:
        return FADING_TO_OFF if s["stopping"] else FADING
    return RAMPING, OFF if s["stopping"] else FAULT if s["fault"] != NO_FAULT else READY


@pytest.mark.parametrize("command", [ARM, DISARM, STOP, RESET, HOLD])
@pytest.mark.parametrize("start", TABLE)
def test_commands(start, command):
    reach, state, outcomes = TABLE[start]
    cell = reach()
    assert where(cell) == state
    latched = int(cell.s["fault"])
    after = outcomes[command]
    assert cell.step(command) == (after is not REFUSED)
    assert where(cell) == (state if after is REFUSED else after)
    assert cell.s["fault"] == (NO_FAULT if command == RESET and after is not REFUSED else latched)


@pytest.mark.parametrize("start", TABLE)
def test_a_fault_from_every_state(start):
    reach, state, _ = TABLE[start]
    cell = reach()
    before = int(cell.s["fault"])
    axis_fault(cell.p, cell.s, 2, NOT_FINITE, True, 1.5, 0.0)
    after = {OFF: FAULT, READY: FAULT, FAULT: FAULT, TO_OFF: TO_OFF}.get(state, TO_FAULT)
    assert where(cell) == after
    if before == NO_FAULT:
        assert (cell.s["fault"], cell.s["fault_axis"], cell.s["fault_value"]) == (NOT_FINITE, 2, 1.5)
        assert cell.s["fault_cycle"] == cell.s["cycle"]
    else:
        assert cell.s["fault"] == before  # the first one stays
    cell.run(150)
    assert cell.s["state"] == (OFF if state in (OFF, TO_OFF) else FAULT)
    assert cell.s["fault"] != NO_FAULT
    assert cell.voltages == [0.0, 0.0, 0.0]


def test_the_way_through_a_shift():
    cell = ready()
    assert cell.step(ARM)
    course = [where(cell)]
    for _ in range(90):
        cell.step()
        course.append(where(cell))
    assert course == [ARMING] * 90 + [TRACKING]
    assert cell.s["tracking_cycle"] == cell.s["cycle"]
    assert cell.step(DISARM)
    course = [where(cell)]
    for _ in range(100):
        cell.step()
        course.append(where(cell))
    assert course == [FADING] * 40 + [TO_READY] * 60 + [READY]
    assert cell.step(ARM)  # and again
    cell.run(90)
    assert cell.s["state"] == TRACKING
    assert cell.step(STOP)
    cell.run(100)
    assert cell.s["state"] == OFF


@pytest.mark.parametrize("reach", [ready, off, fault])
def test_at_rest_it_stays_where_it_is_at_the_park_voltage(reach):
    cell = reach()
    state = where(cell)
    course = cell.run(300)
    assert where(cell) == state
    assert (course == 0.0).all()


# -- smoothness --------------------------------------------------------------------------------------


def test_smooth_is_minimum_jerk():
    x = np.linspace(0.0, 1.0, 1001)
    y = np.array([minimum_jerk(value) for value in x])
    assert (y[0], y[-1], minimum_jerk(0.5)) == (0.0, 1.0, 0.5)
    assert (minimum_jerk(-3.0), minimum_jerk(7.0)) == (0.0, 1.0)
    assert (np.diff(y) >= 0.0).all()
    assert y == pytest.approx(10 * x**3 - 15 * x**4 + 6 * x**5, abs=1e-12)
    speed, acceleration = np.gradient(y, x), np.gradient(np.gradient(y, x), x)
    assert max(speed[0], speed[-1]) < 1e-4
    assert np.abs(acceleration[[0, -1]]).max() < 0.1
    assert speed.max() == pytest.approx(1.875, rel=1e-3)
    assert np.abs(acceleration).max() == pytest.approx(5.7735, rel=1e-2)


@pytest.mark.parametrize("after", [DISARM, STOP, NO_COMMAND])
def test_the_way_to_park_is_smooth(after):
    """Speed and acceleration stay below those of the minimum-jerk course; nothing overshoots."""
    cell = BenchCell(parameters(ramp=200)).arm()
    cell.run(50)
    if after == NO_COMMAND:
        start = np.array(cell.voltages)
        cell_fault(cell.p, cell.s, DRIVER_ERROR, True, 1.0, 0.0)
        assert cell.step() is True
    else:
        assert cell.step(after)
        cell.run(int(cell.p["authority_cycles"]) - 1)  # first the correction is faded out
        start = np.array(cell.voltages)
        cell.step()
    first = np.array(cell.voltages)
    course = np.vstack([start, first, cell.run(210)])
    n = 200.0
    assert np.abs(start).min() > 5.0  # there is a way to go
    assert (np.abs(np.diff(course, axis=0)) <= 1.9 * np.abs(start) / n + 1e-12).all()
    assert (np.abs(np.diff(course, 2, axis=0)) <= 6.0 * np.abs(start) / n**2 + 1e-12).all()
    assert (np.diff(course, axis=0) * np.sign(start) <= 1e-12).all()
    assert (course[-5:] == 0.0).all()


def test_a_ramp_too_quick_for_the_slew_still_ends_at_park():
    record = parameters(ramp=3)
    cell = BenchCell(record).arm()
    assert cell.step(DISARM)
    cell.run(38)
    before = np.array(cell.voltages)
    course = np.vstack([before, cell.run(60)])
    slew = record[0]["axis"][0]["limiter"]["slew_V"]
    assert (np.abs(np.diff(course, axis=0)) <= slew + 1e-12).all()
    assert (course[-1] == 0.0).all()
    assert cell.s["state"] == READY


def test_arming_is_bumpless():
    """The first cycle changes next to nothing, the lift is smooth, and the end is the working point."""
    cell = BenchCell(parameters(lift=600, settle=100, authority=100))
    cell.run(5)
    assert cell.step(ARM)
    assert np.abs(cell.voltages).max() < 1e-9
    course = np.vstack([cell.voltages, cell.run(800)])
    assert np.abs(np.diff(course[:20], axis=0)).max() < 0.02
    assert np.abs(np.diff(course[:700], axis=0)).max() < 1.0
    assert cell.strain[X] == pytest.approx(66.0, abs=15.0)
    assert cell.strain[Y] == pytest.approx(60.0, abs=5.0)
    assert cell.voltages[Z] == pytest.approx(50.0, abs=1.0)


def test_arming_away_from_park():
    """Where an actuator stands is where it is taken over, in each mode."""
    record = parameters()
    for i, park in enumerate((40.0, 30.0, 20.0)):
        record[0]["axis"][i]["limiter"]["park_V"] = park
    cell = BenchCell(record)
    cell.run(60)
    assert cell.step(ARM)
    assert cell.voltages == pytest.approx([40.0, 30.0, 20.0], abs=1e-6)
    cell.run(3)
    assert cell.voltages == pytest.approx([40.0, 30.0, 20.0], abs=0.5)


# -- sensors -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("role", "axis", "code"),
    [("strain", X, STRAIN_INVALID), ("strain", Y, STRAIN_INVALID), ("stage", X, STAGE_INVALID)],
)
@pytest.mark.parametrize("spoil", [(math.nan, 0), (math.inf, 0), (1.0, 5), None])
def test_three_bad_samples_of_a_sensor_in_use_are_noticed_and_then_a_fault(role, axis, code, spoil):
    cell = tracking()
    cell.spoiled[role, axis] = spoil
    bad_cycles = 2 if spoil else 5  # silent: 300 us pass before the last sample is too old
    cell.run(bad_cycles)
    assert cell.s["events"] == 0
    cell.run(1)
    assert (cell.s["events"], cell.s["event"][0]["code"]) == (1, COASTING if role == "strain" else DEGRADED)
    cell.run(4 if role == "strain" else 9)  # without it for so long
    assert cell.s["state"] == TRACKING
    cell.run(1)
    assert where(cell) == TO_FAULT
    silent = spoil is None and role == "strain"
    assert (cell.s["fault"], cell.s["fault_axis"]) == (STRAIN_SILENT if silent else code, axis)
    cell.run(60)
    assert cell.s["state"] == FAULT
    cell.spoiled.clear()
    cell.run(200)
    assert cell.s["state"] == FAULT  # latched


@pytest.mark.parametrize(("role", "axis"), [("stage", Y), ("strain", Z), ("stage", Z), ("deviation", Y)])
def test_a_sensor_that_is_not_used_does_no_harm(role, axis):
    cell = tracking()
    cell.spoiled[role, axis] = (math.nan, 1)
    cell.run(50)
    assert cell.s["state"] == TRACKING


@pytest.mark.parametrize("axis", [X, Y])
def test_arming_is_refused_with_a_bad_strain_gauge(axis):
    cell = ready()
    cell.spoiled["strain", axis] = (math.nan, 0)
    cell.step()
    assert not cell.step(ARM)
    assert cell.s["state"] == READY
    cell.spoiled.clear()
    cell.step()
    assert cell.step(ARM)


@pytest.mark.many_cycles
def test_the_stage_may_be_out_of_its_sensors_range_until_the_outer_loop_is_closed():
    """At rest it is: the lift brings it in, or closing the loop is a fault."""
    record = parameters(lift=600, settle=100, authority=100, ramp=600)
    record[0]["axis"][X]["stage_range_um"] = -300.0, 300.0
    cell = BenchCell(record)
    cell.run(10)
    assert cell.s["axis"][X]["stage"]["bad"] == 10
    assert cell.step(ARM)
    cell.run(750)
    assert cell.s["axis"][X]["stage"]["bad"] == 0
    assert cell.s["axis"][X]["estimator"]["running"] == 1
    cell.run(50)
    assert cell.s["state"] == TRACKING

    lost = BenchCell(record)
    lost.spoiled["stage", X] = (-300.0, 1)
    lost.run(10)
    assert lost.step(ARM)
    course = lost.run(699)
    assert lost.s["state"] == ARMING
    course = np.vstack([course, lost.run(20)])
    assert where(lost) == TO_FAULT
    assert (lost.s["fault"], lost.s["fault_axis"]) == (STAGE_INVALID, X)
    assert np.abs(np.diff(course[-20:], axis=0)).max() < 0.5


def test_arming_is_refused_before_a_sensor_has_spoken():
    record = parameters()
    record[0]["axis"][Y]["strain_age_ns"] = 2**61
    cell = BenchCell(record)
    cell.spoiled["strain", Y] = None
    cell.run(5)
    assert not cell.step(ARM)


def test_a_set_point_that_is_not_finite_is_a_fault_and_the_output_goes_home():
    cell = tracking()
    cell.s["axis"][X]["estimator"]["x"][0] = math.nan
    before = np.array(cell.voltages)
    cell.step()
    assert (cell.s["fault"], cell.s["fault_axis"]) == (NOT_FINITE, X)
    assert where(cell) == TO_FAULT
    assert np.abs(np.array(cell.voltages) - before).max() <= 4.0
    course = cell.run(70)
    assert np.isfinite(course).all()
    assert (course[-1] == 0.0).all()


def _spoil_integrator(cell, axis):
    cell.s["axis"][axis]["pid"]["integrator"] = math.nan


def _spoil_derivative(cell, axis):
    cell.s["axis"][axis]["pid"]["derivative"] = math.nan


def _spoil_inverse(cell, axis):
    cell.p["axis"][axis]["hysteresis"]["rho_hat"][0] = math.nan


def _spoil_gain(cell, axis):
    cell.p["axis"][axis]["pid"]["K_V_per_um"] = math.nan


def test_an_estimate_that_is_not_finite_is_noticed_before_the_loop_is_closed_on_it():
    cell = armed()
    assert cell.s["axis"][X]["estimator"]["running"] == 1
    cell.s["axis"][X]["estimator"]["x"][2] = math.nan
    cell.step()
    assert (cell.s["fault"], cell.s["fault_axis"]) == (NOT_FINITE, X)
    assert where(cell) == TO_FAULT


@pytest.mark.parametrize("axis", [X, Y])
@pytest.mark.parametrize("spoil", [_spoil_integrator, _spoil_derivative, _spoil_inverse, _spoil_gain])
def test_no_stage_of_the_law_may_be_anything_but_finite(spoil, axis):
    """Noticed in that cycle, the output within its slew; and nothing of it is left in the next session."""
    cell = tracking()
    good = cell.p.copy()
    before = np.array(cell.voltages)
    spoil(cell, axis)
    cell.step()
    assert (cell.s["fault"], cell.s["fault_axis"]) == (NOT_FINITE, axis)
    assert where(cell) == TO_FAULT
    assert np.abs(np.array(cell.voltages) - before).max() <= 4.0
    course = cell.run(100)
    assert np.isfinite(course).all()
    assert (course[-1] == 0.0).all()
    cell.parameters[0] = good
    assert cell.step(RESET)
    cell.run(5)
    assert cell.step(ARM)
    cell.run(int(cell.p["lift_cycles"] + cell.p["settle_cycles"] + cell.p["authority_cycles"]))
    assert cell.s["state"] == TRACKING
    assert cell.s["fault"] == NO_FAULT


@pytest.mark.many_cycles
@pytest.mark.parametrize("value", [1e308, -1e308, 1e300])
def test_one_absurd_but_finite_strain_sample_does_not_poison_the_loop(value):
    """Either it is a fault, or the axis works again once the sensor does: an output frozen for good is neither."""
    cell = tracking()
    cell.spoiled["strain", Y] = (value, 0)
    cell.run(1)
    cell.spoiled.clear()
    cell.run(400)
    if cell.s["state"] == TRACKING:
        assert np.isfinite(cell.s["axis"][Y]["pid"]["integrator"])
        assert abs(cell.strain[Y] - cell.s["axis"][Y]["setpoint_um"]) < 2.0
    else:
        assert cell.s["fault"] != NO_FAULT


# -- held samples, overruns ----------------------------------------------------------------------------


def test_a_held_strain_sample_is_neither_integrated_nor_differentiated():
    cell = tracking()
    cell.run(5)
    pid = cell.s["axis"][Y]["pid"]
    integrator, derivative = float(pid["integrator"]), float(pid["derivative"])
    cell.spoiled["strain", Y] = None
    for held in (1, 2):
        cell.step()
        assert (pid["integrator"], pid["derivative"]) == (integrator, derivative)
        assert cell.s["axis"][Y]["supervisor"]["passed"] == held
    cell.spoiled.clear()
    error_before = float(pid["error"])
    cell.step()
    error, p = float(pid["error"]), cell.p["axis"][Y]["pid"]
    assert error != error_before
    # one backward Euler step over the three cycles since the last fresh sample, two of them for the integral
    assert pid["integrator"] == pytest.approx(integrator + 2 * p["integral"] * error, abs=1e-9)
    filtered = (p["filter_s"] * derivative + p["derivative"] * (error - error_before)) / (p["filter_s"] + 3e-4)
    assert pid["derivative"] == pytest.approx(filtered, abs=1e-9)
    assert cell.s["axis"][Y]["supervisor"]["passed"] == 0


@pytest.mark.parametrize("periods", [2, 7])
def test_periods_that_an_overrun_skipped_are_predicted_but_not_integrated(periods):
    """The estimator knows how many passed; the error seen after them did not stand while they passed."""
    cell = tracking()
    cell.run(20)
    before = int(cell.s["cycle"])
    a, p = cell.s["axis"][Y], cell.p["axis"][Y]["pid"]
    integrator = float(a["pid"]["integrator"])
    cell.step(periods=periods)
    assert cell.s["cycle"] == before + periods
    assert cell.s["axis"][X]["estimator"]["cycle"] == before + periods
    expected = integrator + p["integral"] * a["pid"]["error"] - p["tracking"] * (a["request_V"] - a["voltage_V"])
    assert a["pid"]["integrator"] == pytest.approx(expected, abs=1e-9)


# -- outputs -------------------------------------------------------------------------------------------


def test_what_is_written_is_what_the_gate_let_through():
    cell = tracking()
    for _ in range(50):
        before = [float(cell.s["axis"][i]["voltage_V"]) for i in range(3)]
        cell.step()
        for i in range(3):
            gate = limit(cell.p["axis"][i]["limiter"], before[i], cell.s["axis"][i]["request_V"], True)
            assert cell.voltages[i] == gate == cell.s["axis"][i]["voltage_V"]
