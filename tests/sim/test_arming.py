"""Arming on the simulated cell: checks, sweep, refusals; hold and resume; jogging."""

import re

import numpy as np
import pytest

from micromanip.host.refusals import axis_refusals, refusals
from micromanip.rt.phases import BUMPING, CLOSED, LIFTING, PARKED, PROBING, SWEEPING
from micromanip.rt.states import (
    ARM,
    ARMED,
    DISARM,
    FAULT,
    HOLD,
    HOLDING,
    RAMPING,
    READY,
    RESET,
    STAGE_CHECK,
    STRAIN_CHECK,
    TRACKING,
)
from micromanip.settings.check import prepare
from micromanip.sim.virtual import VirtualCell

from .protected import course, states, text

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
    assert phases(rows) == [PARKED, PROBING, LIFTING, BUMPING, SWEEPING, LIFTING, CLOSED]
    assert states(rows) == [READY, ARMED, TRACKING]
    voltage = rows["axis"]["voltage_V"]
    probing = rows["phase"] == PROBING
    # one axis after the other, 5 V each, and the others rest
    moved = np.ptp(voltage[probing], axis=0)
    assert moved == pytest.approx([5.0] * 3, abs=1e-6)
    third = probing.sum() // 3
    first = voltage[probing][:third]
    assert np.ptp(first[:, 1:]) == 0.0
    bump = rows["axis"]["stage_um"][rows["phase"] == BUMPING]
    assert np.ptp(bump[:, 0]) == pytest.approx(10.0, rel=0.6)  # 2 um of the actuator; it swings, being undamped
    armed.run(1.2, command=DISARM)
    assert armed.state[0]["state"] == READY
    again = armed.arm()
    assert phases(again) == [PARKED, LIFTING, SWEEPING, LIFTING, CLOSED]


def test_the_sweep_swings_wider_than_the_model_remembers(tmp_path):
    rows = cell(tmp_path).arm()
    swept = rows["axis"]["setpoint_um"][rows["phase"] == SWEEPING]
    peaks = np.abs(swept - 66.0)
    assert (peaks.max(axis=0) > 35.07).all()  # the widest play
    halves = peaks.reshape(10, -1, 3).max(axis=1)
    assert (np.diff(halves[1:], axis=0) < 0.0).all()
    assert peaks[-1].max() < 0.5


@pytest.mark.parametrize(
    ("change", "code", "axis"),
    [
        # two gauges swapped: the step of x moves the gauge of y
        (
            [(r"strain_x: \{driver: cell,", "strain_x: {driver: cell, channel: strain_y,"),
             (r"strain_y: \{driver: cell,", "strain_y: {driver: cell, channel: strain_x,")],
            STRAIN_CHECK, 0,
        ),
        ([(r"stage_y: \{driver: cell,", "stage_y: {driver: cell, channel: stage_z,")], STAGE_CHECK, 1),
        ([(r"voltage_z: \{driver: cell, ", "voltage_z: {driver: cell, slew_V_per_ms: 0.001, ")], None, None),
    ],
)  # fmt: skip
def test_wrong_wiring_is_found_before_a_loop_is_closed(tmp_path, change, code, axis):
    if code is None:
        wrong = cell(tmp_path)
        wrong.parameters[0]["axis"][2]["limiter"]["slew_V"] = 1e-6  # the output does not move
        code, axis = STRAIN_CHECK, 2
    else:
        wrong = cell(tmp_path, *change)
    wrong.run(0.01)
    rows = wrong.run(3.0, command=ARM)
    s = wrong.state[0]
    assert (s["state"], s["fault"], s["fault_axis"]) == (FAULT, code, axis)
    assert states(rows) == [ARMED, RAMPING, FAULT]
    closed = {STRAIN_CHECK: LIFTING, STAGE_CHECK: SWEEPING}[code]
    assert closed not in rows["phase"]
    assert abs(s["fault_value"]) < s["fault_limit"] or s["fault_value"] > s["fault_limit"]
    wrong.run(0.0001, command=RESET)
    assert wrong.run(3.0, command=ARM)["state"][-1] == FAULT  # checked again: it was not passed


def test_a_gauge_with_its_sign_reversed(tmp_path):
    wrong = cell(tmp_path)
    wrong.parameters[0]["axis"][1]["strain_check"]["step"] *= -1.0  # as if the answer came with the other sign
    for side, other in (("low", "high"), ("high", "low")):
        wrong.parameters[0]["axis"][1]["strain_check"][side] = -0.74 * (3.0 if other == "high" else 1 / 3.0)
    wrong.run(0.01)
    wrong.run(2.0, command=ARM)
    assert (wrong.state[0]["fault"], wrong.state[0]["fault_axis"]) == (STRAIN_CHECK, 1)


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
    rows = refused.run(0.05, command=ARM)
    s = refused.state[0]
    assert set(rows["state"]) == {READY}
    assert (rows["axis"]["voltage_V"] == 0.0).all()
    assert (s["refused"], s["axis"][1]["refused"], s["axis"][0]["refused"]) == (bits, axis_bits, 0)
    (reason,) = refusals(int(s["refused"]), "READY") + axis_refusals(int(s["axis"][1]["refused"]), "y")
    assert said in reason


def test_hold_and_resume(tmp_path):
    """Held where it is, against the cutting force; then softly on."""
    held = cell(tmp_path)
    held.arm()
    before = held.run(1.0)
    rows = held.run(0.5, command=HOLD)
    assert set(rows["state"]) == {HOLDING}
    assert (rows["lines"] & 16 != 0).all()  # feed-hold
    stage = rows["axis"]["true_stage_um"]
    assert np.abs(stage[500:] - before["axis"]["true_stage_um"][-1]).max() < 30.0
    assert np.ptp(stage[2000:], axis=0).max() < 6.0
    usual = np.abs(np.diff(before["axis"]["voltage_V"], axis=0)).max()
    assert np.abs(np.diff(rows["axis"]["voltage_V"], axis=0)).max() <= 1.5 * usual
    more = held.run(1.5, command=ARM)
    assert states(more) == [ARMED, TRACKING]
    assert dict(course(more))[TRACKING] == held.parameters[0]["authority_cycles"]
    assert np.abs(np.diff(more["axis"]["voltage_V"], axis=0)).max() <= 1.5 * usual
    assert np.abs(more["axis"]["path_error_um"][-3000:]).std() < 2.0
    assert (more["lines"][-3000:] & 16 == 0).all()


def test_a_hold_that_was_asked_for_has_all_the_time(tmp_path):
    held = cell(tmp_path)
    held.arm()
    assert (held.run(3.0, command=HOLD)["state"] == HOLDING).all()
    rows = held.run(1.0, command=DISARM)
    assert states(rows) == [RAMPING, READY]


def test_soft_stop_fades_the_correction_out_before_the_ramp(tmp_path):
    stopped = cell(tmp_path)
    stopped.arm()
    stopped.run(0.5)
    rows = stopped.run(1.2, command=DISARM)
    fading = rows[rows["phase"] == CLOSED]
    assert len(fading) == stopped.parameters[0]["authority_cycles"]
    assert np.abs(fading["axis"]["stage_um"][-1]).max() < 5.0
    assert states(rows) == [RAMPING, READY]
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
    jogged.run(0.5, command=HOLD)
    again = jogged.run(1.0, command=ARM)
    assert again["state"][-1] == TRACKING
    assert np.ptp(again["axis"]["reference_um"][:, 0]) < 1.0  # nothing goes anywhere by itself
