"""Every row of the table of faults, injected: state, reaction time in cycles, voltages, what is told."""

import numpy as np
import pytest

from micromanip.faults import latched
from micromanip.rt import states as rt

from .protected import Protected, course, states

HOLD_RAMP = [rt.TRACKING, rt.HOLDING, rt.RAMPING, rt.FAULT]
RAMP = [rt.TRACKING, rt.RAMPING, rt.FAULT]
X = 0


def assert_latched(cell, code, axis):
    """Latched, told in words, and nothing re-arms."""
    assert (cell.s["state"], cell.s["fault"], cell.s["fault_axis"]) == (rt.FAULT, code, axis)
    name = "xyz"[axis] if axis >= 0 else None
    (report,) = latched(cell.s, "xyz", list(cell.prepared.wiring.drivers))
    message = str(report)
    assert message.startswith("X-")
    assert name is None or f"axis {name}" in message
    assert "nan" not in message
    cell.cell.run(0.0001, command=rt.ARM)
    cell.run(0.2)
    assert cell.s["state"] == rt.FAULT
    assert cell.s["trips"] == 1


@pytest.mark.parametrize(
    ("fault", "cycles"),
    [("kind: nan", 3), ("kind: value, value: 175.0", 3), ("kind: offset, value: 30.0", 3), ("kind: status", 3),
     ("kind: drop", 6)],
)  # fmt: skip
def test_strain_gauge_unusable(fault, cycles):
    """Three samples, or 300 us of silence and three cycles: 5 ms without feedback, then the ramp.

    A gauge that nothing comes from is not blamed: it may be the computer, the bus or the device that stood still.
    """
    named = rt.STRAIN_SILENT if fault == "kind: drop" else rt.STRAIN_INVALID
    cell = Protected(f"channel: strain_x, {fault}")
    rows = cell.run(1.0)
    (at, warned, *_), (coasted, tripped, *_) = cell.events[:2]
    assert (warned, tripped) == (rt.COASTING, named)
    assert at == cycles - 1  # the first bad sample came in cycle 0
    assert coasted - at == 50
    assert states(rows) == RAMP
    assert dict(course(rows))[rt.RAMPING] == coasted
    feedback = rows["axis"]["feedback_V"][at:coasted, X]
    assert np.ptp(feedback) < 1e-9 + 4.0 * cell.p["axis"][X]["pid"]["tracking"]  # no sample is acted on
    assert np.abs(np.diff(rows["axis"]["voltage_V"][: coasted + 100, X])).max() < 2.0
    assert_latched(cell, named, X)


def test_strain_gauge_stuck():
    cell = Protected("channel: strain_x, kind: freeze")
    rows = cell.run(1.0)
    assert [event[1] for event in cell.events] == [rt.COASTING, rt.STRAIN_STUCK]
    assert 18 <= cell.events[0][0] <= 20
    assert states(rows) == RAMP
    assert_latched(cell, rt.STRAIN_STUCK, X)


def test_two_bad_samples_are_nothing():
    cell = Protected("channel: strain_x, kind: nan, for_s: 0.0002", "channel: stage_y, kind: drop, for_s: 0.0002")
    rows = cell.run(0.5)
    assert cell.s["events"] == 0
    assert states(rows) == [rt.TRACKING]
    assert np.abs(rows["axis"]["path_error_um"]).max() < 12.0


def test_capacitive_sensor_unusable():
    """A second on the model's prediction, without a bump; then the ramp."""
    cell = Protected("channel: stage_x, kind: status")
    rows = cell.run(2.0)
    (at, warned, *_), (late, tripped, *_) = cell.events
    assert (warned, tripped) == (rt.DEGRADED, rt.STAGE_INVALID)
    assert at == 2
    assert late - at == 10_000
    assert states(rows) == RAMP
    setpoint = rows["axis"]["setpoint_um"]
    usual = np.abs(np.diff(cell.before["axis"]["setpoint_um"][17_000:20_000, X])).max()
    assert np.abs(np.diff(setpoint[:10, X])).max() <= 1.2 * usual
    assert np.abs(rows["axis"]["path_error_um"][:10_000, X]).max() < 100.0  # uncompensated it would be 150
    assert_latched(cell, rt.STAGE_INVALID, X)


def test_capacitive_sensor_back_in_time():
    """The loop takes it up again without a bump, and nothing is latched."""
    cell = Protected("channel: stage_x, kind: drop, for_s: 0.4")
    rows = cell.run(1.0)
    assert [event[1] for event in cell.events] == [rt.DEGRADED]
    assert states(rows) == [rt.TRACKING]
    assert cell.s["fault"] == rt.NO_FAULT
    usual = np.abs(np.diff(cell.before["axis"]["setpoint_um"][17_000:20_000, X])).max()
    assert np.abs(np.diff(rows["axis"]["setpoint_um"][3990:4020, X])).max() <= 2.0 * usual
    assert np.abs(rows["axis"]["path_error_um"][8000:, X]).std() < 2.0


def test_capacitive_sensor_stuck():
    cell = Protected("channel: stage_x, kind: freeze", limits="  axis: {stage: {degraded_s: 0.01}}\n")
    rows = cell.run(1.0)
    assert cell.events[-1][1] in (rt.STAGE_STUCK, rt.DISAGREEMENT)
    assert states(rows)[-1] == rt.FAULT
    assert cell.events[0][0] <= 20


def test_gauge_and_capacitive_sensor_disagree():
    """Nobody knows which is wrong: the voltage is kept, then the ramp."""
    cell = Protected("channel: stage_x, kind: offset, value: 3.0")
    rows = cell.run(2.0)
    at, code, axis, value, limit = cell.events[0]
    assert (code, axis) == (rt.DISAGREEMENT, X)
    assert value > limit
    assert at <= 100
    assert states(rows) == HOLD_RAMP
    when = dict(course(rows))
    assert when[rt.HOLDING] == at
    held = rows["axis"]["voltage_V"][when[rt.HOLDING] : when[rt.RAMPING], X]
    assert np.ptp(held) == 0.0
    others = rows["axis"]["stage_um"][when[rt.HOLDING] + 500 : when[rt.RAMPING], 1:]
    assert np.ptp(others, axis=0).max() < 5.0  # they are held where they were, against the same forces
    assert_latched(cell, rt.DISAGREEMENT, X)


def test_hold_with_a_frozen_voltage_is_not_resumed():
    cell = Protected("channel: stage_x, kind: offset, value: 3.0")
    cell.run(0.1)
    cell.cell.run(0.0001, command=rt.ARM)
    assert cell.s["state"] == rt.HOLDING
    assert cell.s["arming"]["refused"][X] & rt.NOT_RESUMABLE


def test_a_small_step_of_the_gauge_is_taken_for_a_disturbance():
    """The capacitive sensor leads: the stage stays on its path, and nothing is to be stopped."""
    cell = Protected("channel: strain_x, kind: offset, value: 8.0")
    rows = cell.run(1.0)
    assert cell.s["events"] == 0
    assert np.abs(rows["axis"]["path_error_um"][2000:, X]).max() < 12.0
    assert rows["axis"]["path_error_um"][2000:, X].std() < 2.0


def test_following_error():
    cell = Protected(force="{start_s: 2.0, static_N: 300.0, rise_ms: 1.0, tooth_N: 0.0, noise_N: 0.0}",
                     limits="  axis: {disagreement: {ratio: null}, following_error: {limit_um: 5.0}}\n")  # fmt: skip
    rows = cell.run(2.5)
    at, code, axis, value, limit = cell.events[0]
    assert code == rt.FOLLOWING_ERROR
    assert value > limit == 5.0
    error = np.abs(rows["axis"]["reference_um"] - rows["axis"]["stage_um"])[:, axis]
    first = int(np.argmax(error > 5.0))
    assert 48 <= at - first <= 52  # 5 ms
    assert states(rows) == HOLD_RAMP
    when = dict(course(rows))
    assert 2900 <= when[rt.RAMPING] - when[rt.HOLDING] <= 3100  # as soon as the tool is retracted, 0.3 s
    assert_latched(cell, rt.FOLLOWING_ERROR, axis)


def test_voltage_saturated():
    off = "disagreement: {ratio: null}, following_error: {limit_um: null}, oscillation: {limit_um: null}"
    cell = Protected(limits=f"  axis: {{{off}}}\n")
    cell.p["axis"]["limiter"]["high_V"] = 50.0  # less voltage than the path needs
    rows = cell.cell.run(2.5)
    events = cell.events
    warned = {axis: at for at, code, axis, *_ in events if code == rt.SATURATING}
    tripped = [(at, axis) for at, code, axis, *_ in events if code == rt.SATURATED]
    assert tripped, events
    at, axis = tripped[0]
    assert states(rows) == HOLD_RAMP
    assert rows["axis"]["voltage_V"][at - 10, axis] == 50.0
    assert at - warned[axis] == 4500


@pytest.mark.parametrize(("gain", "trips"), [(4.0, False), (8.0, True)])
def test_inner_loop_swings(gain, trips):
    """The fallback gains once; where they don't help, the ramp."""
    cell = Protected()
    pid = cell.p["axis"][X]["pid"]
    for name in ("K_V_per_um", "integral", "derivative"):
        pid[name] *= gain
        cell.p["axis"][X]["fallback"][name] = (0.95 if trips else 0.4 / gain) * pid[name]
    rows = cell.run(1.5)
    codes = [code for _, code, *_ in cell.events]
    assert codes[0] == rt.FALLBACK
    if trips:
        assert codes[:2] == [rt.FALLBACK, rt.OSCILLATION]
        assert states(rows) == RAMP
        assert_latched(cell, rt.OSCILLATION, X)
    else:
        assert codes == [rt.FALLBACK]
        assert states(rows) == [rt.TRACKING]
        assert np.abs(rows["axis"]["path_error_um"][10_000:, X]).std() < 5.0


def test_reference_late_is_extrapolated():
    cell = Protected("channel: deviation_x, kind: drop, for_s: 0.006")
    rows = cell.run(0.3)
    assert [(code, axis) for _, code, axis, *_ in cell.events] == [(rt.REFERENCE_STALE, X)]
    assert states(rows) == [rt.TRACKING]
    assert np.abs(rows["axis"]["path_error_um"][:, X]).max() < 12.0


def test_reference_lost():
    """Held, the feed stopped, back to the working point in 200 ms, and down when the tool is out of the cut."""
    cell = Protected("channel: deviation_x, kind: drop")
    rows = cell.run(2.0)
    assert [code for _, code, *_ in cell.events] == [rt.REFERENCE_STALE, rt.REFERENCE_LOST]
    assert cell.events[1][0] == pytest.approx(200, abs=15)  # 20 ms after the last sample
    assert states(rows) == HOLD_RAMP
    when = dict(course(rows))
    assert (rows["lines"][when[rt.HOLDING] :] & 16 != 0).all()  # feed-hold
    at_rest = rows["axis"]["stage_um"][when[rt.HOLDING] + 2500 : when[rt.RAMPING]]
    assert np.abs(at_rest).max() < 3.0
    step = np.abs(np.diff(rows["axis"]["setpoint_um"][when[rt.HOLDING] - 5 : when[rt.HOLDING] + 2500], axis=0)).max()
    usual = np.abs(np.diff(cell.before["axis"]["setpoint_um"][17_000:20_000], axis=0)).max()
    assert step <= 1.5 * usual
    assert_latched(cell, rt.REFERENCE_LOST, X)


@pytest.mark.parametrize("offset_um", [70.0, -120.0])
def test_a_tracker_that_jumps_and_stays_is_not_followed(offset_um):
    """However long the reference may be away: it is lost, and the stage goes back to its working point."""
    cell = Protected(
        f"channel: deviation_x, kind: offset, value: {offset_um}",
        limits="  axis: {reference: {stale_periods: 20, time_ms: 500}}\n",
    )
    place_um = cell.before["axis"]["true_stage_um"][-1, X]
    rows = cell.run(2.5)
    assert [code for _, code, *_ in cell.events] == [rt.REFERENCE_STALE, rt.REFERENCE_LOST]
    assert cell.events[1][0] == pytest.approx(5000, abs=15)
    assert states(rows) == HOLD_RAMP
    stage = rows["axis"]["true_stage_um"][:5000, X]
    assert np.abs(stage - place_um).max() < 35.0  # where it was going for the 20 ms that it is extrapolated
    assert_latched(cell, rt.REFERENCE_LOST, X)


def test_a_tracker_that_comes_back_where_it_may_be_is_followed_again():
    """An outage of 100 ms, five times what is extrapolated."""
    cell = Protected(
        "channel: deviation_x, kind: drop, for_s: 0.1",
        limits="  axis: {reference: {stale_periods: 20, time_ms: 500}, following_error: {limit_um: null}}\n",
    )
    rows = cell.run(0.6)
    assert [code for _, code, *_ in cell.events] == [rt.REFERENCE_STALE]
    assert states(rows) == [rt.TRACKING]
    assert np.abs(rows["axis"]["path_error_um"][4000:, X]).max() < 12.0


@pytest.mark.parametrize(
    "fault", ["kind: nan, for_s: 0.001", "kind: spike, value: 200.0", "kind: value, value: 1.0e6, for_s: 0.001"]
)
def test_one_bad_sample_of_the_reference_is_rejected(fault):
    cell, quiet = Protected(f"channel: deviation_x, {fault}"), Protected()
    rows, usual = cell.run(0.1), quiet.run(0.1)
    assert states(rows) == [rt.TRACKING]
    moved = rows["axis"]["true_stage_um"][:, X] - usual["axis"]["true_stage_um"][:, X]
    assert np.abs(moved).max() < 3.0


def test_amplifier_fault():
    """The amplifier is off at once: nothing is ramped. Memories begin anew at the next arming, as ever."""
    cell = Protected("channel: amplifier_ok_y, kind: value, value: 0.0")
    rows = cell.run(0.5)
    assert [(at, code, axis) for at, code, axis, *_ in cell.events] == [(0, rt.AMPLIFIER_FAULT, 1)]
    assert states(rows) == [rt.FAULT]
    assert (rows["lines"] & 8 == 0).all()  # amplifier enable
    assert (rows["axis"]["voltage_V"][45:] == 0.0).all()
    assert_latched(cell, rt.AMPLIFIER_FAULT, 1)


def test_amplifier_hot():
    """Half the correction while it is hot; if it stays hot, the ramp."""
    cell = Protected("channel: temperature_ok_x, kind: value, value: 0.0")
    rows = cell.run(3.0)
    (at, warned, *_), (late, tripped, *_) = cell.events
    assert (at, warned, tripped) == (0, rt.DERATED, rt.OVER_TEMPERATURE)
    assert late == 20_000
    assert states(rows) == RAMP
    stage, path = (rows["axis"][name][5000:20_000, X] for name in ("stage_um", "deviation_um"))
    share = (stage * path).sum() / (path**2).sum()
    assert share == pytest.approx(0.5, abs=0.05)
    assert_latched(cell, rt.OVER_TEMPERATURE, X)


def test_emergency_stop():
    """In the very cycle; and when the chain is closed again nothing moves before reset and arm."""
    cell = Protected("channel: enable, kind: value, value: 0.0, for_s: 0.3")
    rows = cell.run(1.0)
    assert [(at, code) for at, code, *_ in cell.events] == [(0, rt.ENABLE_LOST)]
    assert states(rows) == [rt.FAULT]
    assert (rows["axis"]["voltage_V"][45:] == 0.0).all()
    assert (rows["lines"][:2000] & 1 == 0).all()
    assert (rows["lines"][4000:] & 1 != 0).all()
    assert_latched(cell, rt.ENABLE_LOST, -1)
    cell.cell.run(0.0001, command=rt.RESET)
    assert cell.s["state"] == rt.READY
    assert (cell.run(0.2)["state"] == rt.READY).all()
    cell.cell.run(0.0001, command=rt.ARM)
    assert cell.cell.run(2.0)["state"][-1] == rt.TRACKING


def test_door_opened():
    cell = Protected("channel: interlock, kind: value, value: 0.0")
    rows = cell.run(1.0)
    assert [(at, code) for at, code, *_ in cell.events] == [(0, rt.INTERLOCK_OPEN)]
    assert states(rows) == [rt.RAMPING, rt.FAULT]
    cell.cell.run(0.0001, command=rt.RESET)
    cell.cell.run(0.0001, command=rt.ARM)
    assert (cell.s["state"], cell.s["refused"]) == (rt.READY, 8)


def test_driver_error():
    cell = Protected("channel: exchange, kind: error, value: 7, for_s: 0.01")
    rows = cell.run(1.0)
    assert states(rows) == [rt.RAMPING, rt.FAULT]
    assert cell.s["fault_value"] == 7.0


def test_a_wire_that_breaks_is_a_line_that_is_off():
    cell = Protected("channel: enable, kind: drop")
    rows = cell.run(0.1)
    assert states(rows) == [rt.TRACKING, rt.FAULT]
    assert cell.events[0][:2] == (3, rt.ENABLE_LOST)  # 300 us


@pytest.mark.parametrize("speed_um_per_s", [20.0, -20.0])
def test_a_capacitive_sensor_that_drifts_slowly(speed_um_per_s):
    """Too slow for the filter, which takes it for a force; the voltage is kept, for nobody knows which one is wrong."""
    cell = Protected(f"channel: stage_x, kind: drift, value: {speed_um_per_s}")
    rows = cell.run(9.0)
    assert_latched(cell, rt.STAGE_DRIFT, X)
    assert states(rows) == HOLD_RAMP
    held = rows[rows["state"] == rt.HOLDING]
    assert np.ptp(held["axis"]["voltage_V"][:, X]) == 0.0
    assert dict(course(rows))[rt.HOLDING] < 80_000  # the force of the process may go against it by 60 um


def test_a_tracker_that_repeats_itself_in_time_is_told():
    cell = Protected("channel: deviation_y, kind: freeze")
    rows = cell.run(0.5)
    assert states(rows) == [rt.TRACKING]
    ((cycle, code, axis, value, limit),) = cell.events
    assert (code, axis, value, limit) == (rt.REFERENCE_STUCK, 1, 200.0, 200.0)
    assert 1900 < cycle < 2100
