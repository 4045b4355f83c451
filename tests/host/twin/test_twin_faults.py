"""The C twin of the cycle notices every fault when our cycle does, and answers it alike."""

import numpy as np
import pytest

from micromanip.rt import states as st
from micromanip.rt.states import ARMING, FAULT, HOLDING, OFF, RAMPING, READY, TRACKING

from .scene import Scene, codes, course

pytestmark = pytest.mark.compiled_only


@pytest.mark.parametrize(("command", "after"), [(st.RESET, READY), (st.STOP, OFF)])
def test_stale_stage(scene, agreed, command, after):
    """Three samples too old, then on the prediction for 40 cycles, then the ramp."""
    scene.sensor("stage")[200:] = scene.sensor("stage")[200]
    scene.reacts(st.STAGE_INVALID, st.RAMPS)
    scene.commands[900 if command == st.RESET else 300] = command
    outcome = agreed(scene.recording())
    rows = outcome.rows
    assert course(rows) == [TRACKING, RAMPING, *([FAULT] if command == st.RESET else []), after]
    ramping = int(np.argmax(rows["state"] == RAMPING))
    assert 240 < ramping < 260
    assert rows["fault"][ramping] == st.STAGE_INVALID
    assert codes(outcome)[:2] == [st.DEGRADED, st.STAGE_INVALID]


def test_degraded_and_back(scene, agreed):
    scene.sensor("stage")[200:230] = scene.sensor("stage")[200]
    outcome = agreed(scene.recording())
    degraded = outcome.rows["axis"]["conditions"][:, 0] >> st.DEGRADED & 1
    assert np.ptp(np.flatnonzero(degraded)) == np.count_nonzero(degraded) - 1 < 40
    assert codes(outcome)[0] == st.DEGRADED
    assert course(outcome.rows) == [TRACKING]


@pytest.mark.parametrize(("lasts", "seen"), [(40, [st.COASTING]), (1000, [st.COASTING, st.STRAIN_STUCK])])
def test_stuck_gauge(scene, agreed, lasts, seen):
    scene.sensor("strain")["value"][200 : 200 + lasts] = scene.sensor("strain")["value"][200]
    scene.axes["strain_rate_um_per_ns"] = np.inf
    scene.reacts(st.STRAIN_STUCK, st.RAMPS)
    outcome = agreed(scene.recording())
    assert codes(outcome)[: len(seen)] == seen
    assert course(outcome.rows)[1:2] == ([RAMPING] if lasts > 40 else [])


def test_oscillation_falls_back_then_ramps(scene, agreed):
    swing = 5.0 * np.sin(2.0 * np.pi * 600.0 * 1e-4 * np.arange(scene.cycles))
    swing[:200] = 0.0
    scene.sensor("strain")["value"] += swing
    scene.limits["band_um"], scene.limits["band_cycles"], scene.limits["band_step"] = 1.0, 50, 0.08
    scene.reacts(st.OSCILLATION, st.RAMPS)
    outcome = agreed(scene.recording())
    assert codes(outcome)[:2] == [st.FALLBACK, st.OSCILLATION]
    assert course(outcome.rows) == [TRACKING, RAMPING, FAULT]


def test_disagreement_freezes_the_axis(scene, agreed):
    """And its hold can't be resumed: it ramps when its time is up."""
    scene.sensor("stage")["value"][200:] += 30.0
    scene.limits["innovation_ratio"], scene.limits["innovation_step"] = 25.0, 0.05
    scene.reacts(st.DISAGREEMENT, st.HOLDS)
    scene.commands[300] = st.ARM
    outcome = agreed(scene.recording())
    rows = outcome.rows
    assert course(rows) == [TRACKING, HOLDING, RAMPING, FAULT]
    assert codes(outcome)[0] == st.DISAGREEMENT
    frozen = rows["axis"]["voltage_V"][rows["state"] == HOLDING, 0]
    assert len(frozen) == 200
    assert np.ptp(frozen) == 0.0
    assert outcome.state["axis"]["refused"][0, 0] & st.NOT_RESUMABLE


def test_saturation_holds(scene, agreed):
    scene.axes["limiter"]["high_V"] = scene.axes["limiter"]["park_V"] + 1.0
    scene.limits["saturating_cycles"], scene.limits["saturated_cycles"] = 5, 20
    scene.reacts(st.SATURATED, st.HOLDS)
    outcome = agreed(scene.recording())
    assert course(outcome.rows) == [TRACKING, HOLDING, RAMPING, FAULT]
    assert codes(outcome)[:2] == [st.SATURATING, st.SATURATED]


def test_following_error_holds(scene, agreed):
    scene.limits["following_um"], scene.limits["following_cycles"] = 1e-3, 2
    scene.reacts(st.FOLLOWING_ERROR, st.HOLDS)
    scene.commands[1000], scene.commands[1010] = st.RESET, st.ARM
    scene.limits["following_um"][1:] = np.inf
    outcome = agreed(scene.recording())
    assert course(outcome.rows)[:5] == [TRACKING, HOLDING, RAMPING, FAULT, READY]
    assert outcome.state["trips"][0] >= 1


def test_lost_reference_decays_and_retraction_ends_the_hold(scene, agreed):
    scene.sensor("deviation")[200:] = scene.sensor("deviation")[200]
    scene.reacts(st.REFERENCE_LOST, st.HOLDS)
    retracted = scene.wire("retracted")
    retracted[:450] = 0.0
    outcome = agreed(scene.recording())
    rows = outcome.rows
    assert course(rows) == [TRACKING, HOLDING, RAMPING, FAULT]
    assert codes(outcome)[:2] == [st.REFERENCE_STALE, st.REFERENCE_LOST]
    assert int(np.argmax(rows["state"] == RAMPING)) == 450
    assert abs(rows["axis"]["reference_um"][449, 0]) < 1.0


def test_hot_amplifier_gets_less_then_ramps(scene, agreed):
    temperature = scene.wire("temperature_ok", 0)
    temperature[200:260] = temperature[600:] = 0.0
    scene.reacts(st.OVER_TEMPERATURE, st.RAMPS)
    outcome = agreed(scene.recording())
    assert codes(outcome)[:3] == [st.DERATED, st.DERATED, st.OVER_TEMPERATURE]
    assert course(outcome.rows) == [TRACKING, RAMPING, FAULT]


@pytest.mark.parametrize(
    ("line", "axis", "code", "reaction", "states"),
    [
        ("enable", None, st.ENABLE_LOST, st.CUTS, [TRACKING, FAULT, READY, ARMING, TRACKING]),
        ("amplifier_ok", 0, st.AMPLIFIER_FAULT, st.CUTS, [TRACKING, FAULT, READY, ARMING, TRACKING]),
        ("interlock", None, st.INTERLOCK_OPEN, st.HOLDS, [TRACKING, HOLDING, RAMPING, FAULT, READY, ARMING, TRACKING]),
    ],
)
def test_line_off(scene, agreed, line, axis, code, reaction, states):
    """Refused while it is off, armed again once it is on and the fault is reset; all switches follow."""
    course_of_line = scene.wire(line, axis)
    course_of_line[200:850] = 0.0
    if axis is not None:
        course_of_line[915:925] = 0.0  # an amplifier that takes its time to come on
    scene.wire_switches()
    scene.p["enable_cycles"] = 30
    scene.reacts(code, reaction)
    scene.commands[[800, 810, 900, 910]] = st.RESET, st.ARM, st.RESET, st.ARM
    outcome = agreed(scene.recording())
    assert course(outcome.rows) == states
    assert outcome.rows["fault"][250] == code
    assert np.ptp(outcome.rows["lines"]) > 0


def test_law_that_is_not_finite(scene, agreed):
    scene.axes["outer"]["reference"][1, 2] = np.nan
    scene.reacts(st.NOT_FINITE, st.RAMPS)
    outcome = agreed(scene.recording())
    assert course(outcome.rows) == [RAMPING, FAULT]
    assert outcome.state["fault_axis"][0] == 1


@pytest.mark.parametrize(("check", "code"), [("strain_check", st.STRAIN_CHECK), ("stage_check", st.STAGE_CHECK)])
def test_check_with_the_wrong_sign(arming, agreed, check, code):
    scene = Scene(arming)
    limits = scene.axes[check]
    limits["low"], limits["high"] = -limits["high"].copy(), -limits["low"].copy()
    scene.reacts(code, st.RAMPS)
    outcome = agreed(scene.recording())
    assert course(outcome.rows) == [READY, ARMING, RAMPING, FAULT]
    assert outcome.state["fault"][0] == code


def test_check_too_short_to_judge(arming, agreed):
    scene = Scene(arming)
    scene.p["check_cycles"] = 1
    scene.reacts(st.STRAIN_CHECK, st.RAMPS)
    outcome = agreed(scene.recording())
    assert outcome.state["fault"][0] == st.STRAIN_CHECK
    assert np.isnan(outcome.state["fault_value"][0])
