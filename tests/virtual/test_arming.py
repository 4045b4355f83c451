"""Arming on the simulated cell: checks, sweep, refusals; hold and resume; jogging."""

import re

import numpy as np
import pytest

from micromanip.host.refusals import refusals
from micromanip.rt import states as rt
from micromanip.rt.arming import OF_GAUGE, OF_STAGE, forget_checks
from micromanip.rt.shadow import swap_cell
from micromanip.settings.check import prepare
from micromanip.settings.load import load
from micromanip.virtual.cell import VirtualCell
from tests.virtual.protected import course, states, text

WAY = rt.PARKED, rt.CHECKING_GAUGE, rt.LIFTING, rt.CHECKING_STAGE, rt.SWEEPING, rt.LIFTING, rt.CLOSED
AT_REST_S = 6.0
"""When the first session is over, and the outputs have come to rest."""


def second_session(tmp_path, *faults):
    """The cell after a session that was well; `faults` of its gauges come while it rests."""
    listed = ", ".join(f"{{at_s: {AT_REST_S}, {fault}}}" for fault in faults)
    armed = cell(tmp_path, ("    lines: {", f"    faults: [{listed}]\n    lines: {{"))
    armed.arm()
    armed.run(0.5)
    assert armed.run(1.2, command=rt.DISARM)["state"][-1] == rt.READY
    armed.run(AT_REST_S + 0.1 - armed.state[0]["cycle"] * 1e-4)
    return armed


def armed_again(armed):
    before = armed.run(0.1)["axis"]["true_stage_um"][-1]
    rows = armed.run(3.0, command=rt.ARM)
    return rows, np.abs(rows["axis"]["true_stage_um"] - before).max(axis=0)


@pytest.mark.parametrize("scale", [0.01, -1.0, 0.1, 8.0])
@pytest.mark.parametrize("axis", [0, 2])
def test_a_gauge_that_shows_too_little_too_much_or_the_wrong_sense(tmp_path, scale, axis):
    wrong = second_session(tmp_path, f"channel: strain_{'xyz'[axis]}, kind: scale, value: {scale}")
    rows, moved_um = armed_again(wrong)
    s = wrong.state[0]
    assert (s["state"], s["fault"], s["fault_axis"]) == (rt.FAULT, rt.STRAIN_CHECK, axis)
    assert rt.CLOSED not in rows["phase"]
    assert rt.SWEEPING not in rows["phase"]
    assert rows["axis"]["voltage_V"][:, axis].max() < 30.0
    assert moved_um[axis] < 150.0


@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (0, 2)])
def test_two_gauges_plugged_the_other_way_round(tmp_path, pair):
    swapped = second_session(tmp_path)
    one, other = (swapped.parameters[0]["axis"][i] for i in pair)
    one["strain"], other["strain"] = int(other["strain"]), int(one["strain"])
    rows, _ = armed_again(swapped)
    s = swapped.state[0]
    assert (s["state"], s["fault"]) == (rt.FAULT, rt.STRAIN_CHECK)
    assert s["fault_axis"] in pair
    assert rt.SWEEPING not in rows["phase"]
    assert rows["axis"]["voltage_V"].max() < 60.0


FORCE = "{start_s: 3.5, static_N: 80.0, tooth_N: 40.0, tooth_Hz: 200.0, noise_N: 5.0}"


def cell(tmp_path, *changes, force=FORCE):
    source = text(force=force)
    for old, new in changes:
        source, count = re.subn(old, new, source)
        assert count, old
    file = tmp_path / "cell.yaml"
    file.write_text(source)
    prepared = prepare(file)
    found = VirtualCell(prepared.parameters, prepared.wiring)
    found.parameters[0]["check_cycles"], found.parameters[0]["lift_cycles"] = 2000, 5000  # the stage comes to rest
    return found


def phases(rows):
    changes = np.flatnonzero(np.diff(rows["phase"], prepend=-1))
    return rows["phase"][changes].tolist()


def test_the_whole_way_and_again_without_the_checks(tmp_path):
    armed = cell(tmp_path)
    rows = armed.arm()
    assert phases(rows) == list(WAY)
    assert states(rows) == [rt.READY, rt.ARMING, rt.TRACKING]
    voltage = rows["axis"]["voltage_V"]
    probing = rows["phase"] == rt.CHECKING_GAUGE
    # one axis after the other, 5 V each, and the others rest
    moved = np.ptp(voltage[probing], axis=0)
    assert moved == pytest.approx([5.0] * 3, abs=1e-6)
    third = probing.sum() // 3
    first = voltage[probing][:third]
    assert np.ptp(first[:, 1:]) == 0.0
    bump = rows["axis"]["stage_um"][rows["phase"] == rt.CHECKING_STAGE]
    assert np.ptp(bump[:, 0]) == pytest.approx(10.0, rel=0.6)  # 2 um of the actuator; it swings, being undamped
    armed.run(1.2, command=rt.DISARM)
    assert armed.state[0]["state"] == rt.READY
    again = armed.arm()
    assert phases(again) == [rt.PARKED, rt.LIFTING, rt.SWEEPING, rt.LIFTING, rt.CLOSED]


@pytest.mark.parametrize(
    ("change", "code", "axis"),
    [
        # two gauges swapped: the step of x moves the gauge of y
        (
            [(r"strain_x: \{driver: cell,", "strain_x: {driver: cell, channel: strain_y,"),
             (r"strain_y: \{driver: cell,", "strain_y: {driver: cell, channel: strain_x,")],
            rt.STRAIN_CHECK, 0,
        ),
        ([(r"stage_y: \{driver: cell,", "stage_y: {driver: cell, channel: stage_z,")], rt.STAGE_CHECK, 1),
        ([(r"voltage_z: \{driver: cell, ", "voltage_z: {driver: cell, slew_V_per_ms: 0.001, ")], None, None),
    ],
)  # fmt: skip
def test_wrong_wiring_is_found_before_a_loop_is_closed(tmp_path, change, code, axis):
    if code is None:
        wrong = cell(tmp_path)
        wrong.parameters[0]["axis"][2]["limiter"]["slew_V"] = 1e-6  # the output does not move
        code, axis = rt.STRAIN_CHECK, 2
    else:
        wrong = cell(tmp_path, *change)
    wrong.run(0.01)
    rows = wrong.run(3.0, command=rt.ARM)
    s = wrong.state[0]
    assert (s["state"], s["fault"], s["fault_axis"]) == (rt.FAULT, code, axis)
    assert states(rows) == [rt.ARMING, rt.RAMPING, rt.FAULT]
    closed = {rt.STRAIN_CHECK: rt.LIFTING, rt.STAGE_CHECK: rt.SWEEPING}[code]
    assert closed not in rows["phase"]
    assert abs(s["fault_value"]) < s["fault_limit"] or s["fault_value"] > s["fault_limit"]
    wrong.run(0.0001, command=rt.RESET)
    assert wrong.run(3.0, command=rt.ARM)["state"][-1] == rt.FAULT  # checked again: it was not passed


def test_a_gauge_with_its_sign_reversed(tmp_path):
    wrong = cell(tmp_path)
    wrong.parameters[0]["axis"][1]["check"][OF_GAUGE]["step"] *= -1.0  # as if the answer came with the other sign
    for side, other in (("low", "high"), ("high", "low")):
        wrong.parameters[0]["axis"][1]["check"][OF_GAUGE][side] = -0.74 * (3.0 if other == "high" else 1 / 3.0)
    wrong.run(0.01)
    wrong.run(2.0, command=rt.ARM)
    assert (wrong.state[0]["fault"], wrong.state[0]["fault_axis"]) == (rt.STRAIN_CHECK, 1)


def failing(tmp_path, kind, at_s, channel="stage_x"):
    """The cell whose sensor fails at a set time."""
    fault = f"    faults: [{{channel: {channel}, kind: {kind}, at_s: {at_s}}}]\n    lines: {{"
    return cell(tmp_path, ("    lines: {", fault), force="{static_N: 0.0, tooth_N: 0.0, noise_N: 0.0}")


@pytest.mark.parametrize(
    ("kind", "refused", "code"),
    [
        ("drop", True, None),
        ("nan", True, None),
        # at rest it is at the end of its range, and says no more than that: it has until the loop is to be closed
        ("freeze", False, rt.STAGE_STUCK),
        ("status", False, rt.STAGE_INVALID),
    ],
)
def test_a_session_does_not_arm_on_the_estimate_of_the_one_before(tmp_path, kind, refused, code):
    """The capacitive sensor of x is dead or stuck since the outputs came to rest."""
    second = failing(tmp_path, kind, at_s=3.6)
    second.arm()
    assert second.run(0.9, command=rt.DISARM)["state"][-1] == rt.READY
    second.run(3.7 - second.state[0]["cycle"] * 1e-4)
    rows = second.run(2.5, command=rt.ARM)
    s = second.state[0]
    assert rt.CLOSED not in rows["phase"]
    if refused:
        assert set(rows["state"]) == {rt.READY}
        assert s["arming"]["refused"].tolist() == [rt.STAGE_MISSING, 0, 0]
        (reason,) = refusals(rt.ARM, s, "READY", load(tmp_path / "cell.yaml"), [])
        assert "stage_x is silent" in reason
        assert np.ptp(rows["axis"]["voltage_V"], axis=0).max() == 0.0
    else:
        assert states(rows) == [rt.ARMING, rt.RAMPING, rt.FAULT]
        assert (s["fault"], s["fault_axis"]) == (code, 0)


@pytest.mark.long
@pytest.mark.parametrize("into_s", [0.3, 1.4, 1.6, 2.1])
@pytest.mark.parametrize("kind", ["drop", "nan", "freeze", "status"])
def test_a_capacitive_sensor_that_dies_while_arming(tmp_path, kind, into_s):
    """In the gauge check, the stage check, the sweep, and while the filter settles: no outer loop is closed."""
    dying = failing(tmp_path, kind, at_s=0.01 + into_s)
    dying.parameters[0]["axis"]["limiter"]["slew_V"] = 4.0
    dying.run(0.01)
    rows = dying.run(3.3, command=rt.ARM)
    s = dying.state[0]
    assert states(rows) == [rt.ARMING, rt.RAMPING, rt.FAULT]
    assert s["fault_axis"] == 0
    assert s["fault"] in (rt.STAGE_INVALID, rt.STAGE_STUCK, rt.STAGE_CHECK)
    assert rt.CLOSED not in rows["phase"]
    if kind in ("drop", "nan"):  # what can be no stage out of range is noticed as soon as a gauge would be
        noticed_s = int(np.argmax(rows["state"] == rt.RAMPING)) * 1e-4
        assert noticed_s - into_s < 0.008


def test_an_arming_that_has_no_sample_of_its_own_ends(tmp_path):
    """Nobody limits the sensor's age, and it has said nothing since: it is not closed on what it said long ago."""
    silent = failing(tmp_path, "drop", at_s=2.4)
    silent.parameters[0]["axis"]["stage_age_ns"] = 2**61
    silent.parameters[0]["check_cycles"] = 0
    silent.arm()
    silent.run(0.9, command=rt.DISARM)
    silent.run(2.5 - silent.state[0]["cycle"] * 1e-4)
    # what it said last was good
    silent.state[0]["axis"][0]["stage"]["bad"] = 0
    rows = silent.run(3.0, command=rt.ARM)
    assert states(rows) == [rt.ARMING, rt.RAMPING, rt.FAULT]
    assert silent.state[0]["fault"] in (rt.STAGE_INVALID, rt.STAGE_STUCK)
    assert rt.CLOSED not in rows["phase"]


def jogged(name):
    """Changes: a reference by hand, within reach of an axis z that is in the mode `name`."""
    by_hand = "reference: {source: jog, offset_um: 40, range_um: [20, 60]}\n"
    return (r"reference:\n(  .*\n)+", by_hand), (r"(?s)(\n  z:\n    mode: )stage", rf"\g<1>{name}")


@pytest.mark.parametrize("second", ["strain", "stage"])
def test_a_loop_that_was_never_closed_is_checked_whatever_was_closed_before(tmp_path, second):
    """The gauge of z has the wrong sign; it did not matter as long as z was a voltage."""
    (tmp_path / "later").mkdir()
    wired, later = cell(tmp_path, *jogged("voltage")), cell(tmp_path / "later", *jogged(second))
    for parameters in (wired.parameters, later.parameters):
        limits = parameters[0]["axis"][2]["check"][OF_GAUGE]
        limits["low"], limits["high"] = -limits["high"].copy(), -limits["low"].copy()
    wired.arm()
    assert wired.state[0]["arming"]["check"]["passed"][:, OF_GAUGE].tolist() == [1, 1, 0]
    wired.run(0.9, command=rt.DISARM)
    swap_cell(wired.parameters[0], later.parameters[0], wired.state[0])
    wired.parameters[:] = later.parameters
    wired.run(0.1)
    rows = wired.run(3.0, command=rt.ARM)
    assert (wired.state[0]["fault"], wired.state[0]["fault_axis"]) == (rt.STRAIN_CHECK, 2)
    assert phases(rows)[:2] == [rt.PARKED, rt.CHECKING_GAUGE]
    assert rt.LIFTING not in rows["phase"]
    assert np.count_nonzero(rows["phase"] == rt.CHECKING_GAUGE) == 2000  # x and y were checked, and have not changed
    assert rows["axis"]["voltage_V"].max() <= 5.0 + 1e-9
    assert rows["axis"]["voltage_V"][:, :2].max() == 0.0


def test_only_what_may_have_changed_is_checked_again(tmp_path):
    armed = cell(tmp_path, force="{static_N: 0.0, tooth_N: 0.0, noise_N: 0.0}")
    armed.arm()
    armed.run(1.2, command=rt.DISARM)
    forget_checks(armed.state[0]["arming"][1], OF_GAUGE)
    forget_checks(armed.state[0]["arming"][2], OF_STAGE)
    rows = armed.arm()
    assert phases(rows) == list(WAY)
    assert np.count_nonzero(rows["phase"] == rt.CHECKING_GAUGE) == 2000
    assert np.count_nonzero(rows["phase"] == rt.CHECKING_STAGE) == 4000
    moved = np.ptp(rows["axis"]["voltage_V"][rows["phase"] == rt.CHECKING_GAUGE], axis=0)
    assert moved == pytest.approx([0.0, 5.0, 0.0], abs=1e-6)
    assert rows["state"][-1] == rt.TRACKING


@pytest.mark.parametrize(
    ("channel", "bits", "axis_bits", "said"),
    [
        ("enable", 4, 0, "emergency stop"),
        ("interlock", 8, 0, "guard"),
        ("amplifier_ok_y", 0, 4, "amplifier_ok_y is not 1"),
        ("temperature_ok_y", 0, 8, "temperature_ok_y is not 1"),
        ("deviation_y", 0, 2, "tracker"),
        ("strain_y", 0, 1, "gauge"),
    ],
)
def test_arming_is_refused_with_its_reason(tmp_path, channel, bits, axis_bits, said):
    kind = "drop" if channel.startswith("dev") else "nan" if channel.startswith("strain") else "value"
    source = text().replace(
        "    lines: {", f"    faults: [{{channel: {channel}, kind: {kind}, at_s: 0.02}}]\n    lines: {{"
    )
    file = tmp_path / "cell.yaml"
    file.write_text(source)
    prepared = prepare(file)
    refused = VirtualCell(prepared.parameters, prepared.wiring)
    refused.run(0.1)
    rows = refused.run(0.05, command=rt.ARM)
    s = refused.state[0]
    assert set(rows["state"]) == {rt.READY}
    assert (rows["axis"]["voltage_V"] == 0.0).all()
    assert (s["refused"], s["arming"][1]["refused"], s["arming"][0]["refused"]) == (bits, axis_bits, 0)
    (reason,) = refusals(rt.ARM, s, "READY", prepared.configuration, [])
    assert said in reason


def test_hold_and_resume(tmp_path):
    """Held where it is, against the cutting force; then softly on."""
    held = cell(tmp_path)
    held.arm()
    before = held.run(1.0)
    rows = held.run(0.5, command=rt.HOLD)
    assert set(rows["state"]) == {rt.HOLDING}
    assert (rows["lines"] & 16 != 0).all()  # feed-hold
    stage = rows["axis"]["true_stage_um"]
    assert np.abs(stage[500:] - before["axis"]["true_stage_um"][-1]).max() < 30.0
    assert np.ptp(stage[2000:], axis=0).max() < 6.0
    usual = np.abs(np.diff(before["axis"]["voltage_V"], axis=0)).max()
    assert np.abs(np.diff(rows["axis"]["voltage_V"], axis=0)).max() <= 1.5 * usual
    more = held.run(1.5, command=rt.ARM)
    assert states(more) == [rt.ARMING, rt.TRACKING]
    assert dict(course(more))[rt.TRACKING] == held.parameters[0]["authority_cycles"]
    assert np.abs(np.diff(more["axis"]["voltage_V"], axis=0)).max() <= 1.5 * usual
    assert np.abs(more["axis"]["path_error_um"][-3000:]).std() < 2.0
    assert (more["lines"][-3000:] & 16 == 0).all()


def test_a_hold_that_was_asked_for_has_all_the_time(tmp_path):
    held = cell(tmp_path)
    held.arm()
    assert (held.run(3.0, command=rt.HOLD)["state"] == rt.HOLDING).all()
    rows = held.run(1.0, command=rt.DISARM)
    assert states(rows) == [rt.RAMPING, rt.READY]


def test_soft_stop_fades_the_correction_out_before_the_ramp(tmp_path):
    stopped = cell(tmp_path)
    stopped.arm()
    stopped.run(0.5)
    rows = stopped.run(1.2, command=rt.DISARM)
    fading = rows[rows["phase"] == rt.CLOSED]
    assert len(fading) == stopped.parameters[0]["authority_cycles"]
    assert np.abs(fading["axis"]["stage_um"][-1]).max() < 5.0
    assert states(rows) == [rt.RAMPING, rt.READY]
    usual = np.abs(np.diff(fading["axis"]["voltage_V"][:500], axis=0)).max()
    assert np.abs(np.diff(rows["axis"]["voltage_V"], axis=0)).max() <= 1.2 * usual


JOG = "reference: {source: jog, offset_um: 0, range_um: [-100, 100], speed_um_per_s: 100}\n"


def test_jog(tmp_path):
    jogged = cell(tmp_path, (r"reference:\n(  .*\n)+", JOG), force="{static_N: 0.0, tooth_N: 0.0, noise_N: 0.0}")
    jogged.arm()
    jogged.run(0.5)
    jogged.parameters[0]["axis"][0]["reference"]["target_um"] = 60.0
    rows = jogged.run(1.5)
    path = rows["axis"]["reference_um"]
    speed = np.diff(path[:, 0]) * 1e4
    assert speed.max() == pytest.approx(100.0, rel=0.02)
    assert speed.min() > -1e-6  # no overshoot
    assert np.abs(np.diff(speed)).max() < 3.0  # um/s a cycle: it starts and stops softly
    assert path[-1, 0] == pytest.approx(60.0, abs=0.1)
    assert np.abs(path[:, 1:]).max() == 0.0
    assert rows["axis"]["true_stage_um"][-1, 0] == pytest.approx(60.0, abs=0.5)
    jogged.run(0.5, command=rt.HOLD)
    again = jogged.run(1.0, command=rt.ARM)
    assert again["state"][-1] == rt.TRACKING
    assert np.ptp(again["axis"]["reference_um"][:, 0]) < 1.0  # nothing goes anywhere by itself
