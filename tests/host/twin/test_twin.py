"""The C twin of the cycle does what our cycle does: arming, tracking, holds and stops, samples of any kind."""

from dataclasses import replace

import numpy as np
import pytest

from micromanip.errors import CheckFailed
from micromanip.rt import states as st
from micromanip.rt.laws.estimator import INPUT_HISTORY
from micromanip.rt.laws.reference import JOG
from micromanip.rt.states import ARMING, FAULT, HOLDING, OFF, RAMPING, READY, TRACKING
from micromanip.settings.compile.limits import NEVER

from .scene import SHORT, TRACKING_CYCLES, Scene, codes, course

pytestmark = pytest.mark.compiled_only


def test_arming_and_tracking(arming, agreed):
    outcome = agreed(arming)
    rows = outcome.rows
    assert course(rows) == [READY, ARMING, TRACKING]
    assert list(rows["state"][[-TRACKING_CYCLES - 1, -TRACKING_CYCLES]]) == [ARMING, TRACKING]
    for check in ("strain_check", "stage_check"):
        assert outcome.state["axis"][check]["passed"][0].tolist() == [1, 1, 1]
    assert np.ptp(rows["axis"]["voltage_V"][-TRACKING_CYCLES:, 0]) > 1.0


def test_late_missing_and_false_samples_and_overruns(arming, agreed):
    """Sensors that report late, rarely, not at all for a while, or nonsense; some periods are skipped."""
    random = np.random.default_rng(4)
    scene = Scene(arming)
    for name in SHORT:  # as long as what was recorded: no loop is closed on a stage out of its sensor's range
        scene.p[name] = arming.parameters[0][name]
    scene.axes["authority_step"] = arming.parameters[0]["axis"]["authority_step"]
    cycles, signals = scene.cycles, scene.signals
    start = cycles - TRACKING_CYCLES
    for role in ("strain", "stage", "deviation"):
        place = int(scene.axes[0][role])
        late = np.maximum.accumulate(np.maximum(np.arange(cycles) - random.integers(0, 12, cycles), 0))
        held = np.arange(cycles) // 3 * 3
        signals[:, place] = arming.signals[late[held], place]
        signals["value"][random.integers(start, cycles, 40), place] = np.nan
        signals["value"][random.integers(start, cycles, 40), place] = random.choice([-1e6, 1e6], 40)
        signals["status"][random.integers(start, cycles, 40), place] = 1
        signals["time_ns"][:, place] -= random.integers(0, 99_000, cycles)
        signals[-1500:-1100, place] = signals[-1500, place]
    signals[:5] = 0
    scene.forget_ages()
    # samples that nobody's voltages brought about, at times of their own: a filter that is not free loses its way there
    scene.axes["outer"]["innovation_um"] = scene.axes["outer"]["repeated_um"] = np.inf
    scene.axes["outer"]["gap_cycles"] = NEVER
    scene.p["score_cycles"] = TRACKING_CYCLES // 2
    scene.periods[random.integers(start, cycles, 30)] += random.integers(1, 4, 30)
    scene.periods[-200] = 2 * INPUT_HISTORY
    outcome = agreed(scene.recording())
    axis = outcome.rows["axis"][:, 0]
    assert outcome.rows["state"][-1] == TRACKING
    assert axis["stage_age_ns"].max() > 10_000_000
    assert 0.1 < np.mean(axis["fresh"][start:] & 2 > 0) < 0.5
    assert outcome.state["axis"]["reference"]["rejected"][0, 0] > 0
    assert outcome.state["axis"]["errors"][0, 0] > 0


def test_samples_that_are_false_held_or_come_after_a_gap(scene, agreed):
    """What the filter believes of them."""
    random = np.random.default_rng(5)
    stage, start = scene.sensor("stage"), scene.cycles - TRACKING_CYCLES
    stage["value"][random.integers(start, scene.cycles, 20)] += random.choice([-20.0, 5.0], 20)
    for held in random.integers(start, scene.cycles - 60, 5):
        stage["value"][held : held + 30] = stage["value"][held]
    scene.periods[start + 100] = 50
    scene.forget_ages()
    outcome = agreed(scene.recording())
    assert np.abs(outcome.rows["axis"]["innovation_um"][:, 0]).max() > 5.0


def test_samples_that_jump_are_not_taken(scene, agreed):
    scene.axes["strain_rate_um_per_ns"] = 1e-4
    scene.sensor("strain")["value"][200:205] += 20.0
    scene.sensor("deviation")["value"][300:400] += 60.0
    outcome = agreed(scene.recording())
    axis = outcome.rows["axis"][:, 0]
    assert codes(outcome)[0] == st.COASTING
    assert not np.any(axis["fresh"][200:205] & 1)
    assert outcome.state["axis"]["reference"]["rejected"][0, 0] > 0
    assert np.ptp(axis["reference_um"][295:400]) < 50.0


def test_hold_and_resume(scene, agreed):
    """A soft stop follows, and a second start, which needs no check."""
    scene.commands[200], scene.commands[400] = st.HOLD, st.ARM
    scene.commands[700], scene.commands[1100] = st.DISARM, st.ARM
    outcome = agreed(scene.recording())
    rows = outcome.rows
    assert course(rows) == [TRACKING, HOLDING, ARMING, TRACKING, RAMPING, READY, ARMING, TRACKING]
    assert np.count_nonzero(rows["state"] == RAMPING) >= 100 + 150
    assert outcome.state["axis"]["errors"][0, 0] > 0


def test_hold_while_authority_comes_back(scene, agreed):
    scene.commands[[200, 250, 300, 320]] = st.HOLD, st.ARM, st.HOLD, st.ARM
    assert course(agreed(scene.recording()).rows) == [TRACKING, HOLDING, ARMING, HOLDING, ARMING, TRACKING]


@pytest.mark.parametrize("before", [None, st.HOLD, st.DISARM])
def test_stop(scene, agreed, before):
    scene.commands[300] = st.STOP
    if before is not None:
        scene.commands[250] = before
    rows = agreed(scene.recording()).rows
    assert course(rows)[-2:] == [RAMPING, OFF]


def test_overruns_in_arming_and_ramp(scene, agreed):
    """Both wait for the loop."""
    scene.commands[[200, 600]] = st.DISARM, st.ARM
    scene.periods[[250, 400, 620, 700, 800]] = 40
    scene.forget_ages()
    rows = agreed(scene.recording()).rows
    assert course(rows) == [TRACKING, RAMPING, READY, ARMING, TRACKING]
    assert np.count_nonzero(rows["state"] == ARMING) == 60 + 100 + 20 + 100


def test_refused_arming_says_why(scene, agreed):
    scene.commands[[200, 700]] = st.DISARM, st.ARM
    for role in ("strain", "deviation"):
        scene.sensor(role)[500:] = scene.sensor(role)[500]
    for line in (scene.wire("enable"), scene.wire("interlock"), scene.wire("amplifier_ok", 0)):
        line[500:] = 0.0
    outcome = agreed(scene.recording())
    assert course(outcome.rows) == [TRACKING, RAMPING, READY]
    assert outcome.state["refused"][0] == st.ENABLE_MISSING | st.INTERLOCK_MISSING
    missing = st.STRAIN_MISSING | st.REFERENCE_MISSING | st.AMPLIFIER_MISSING
    assert outcome.state["axis"]["refused"][0, 0] == missing


def test_refused_commands(scene, agreed):
    """On the way from a cut to OFF nothing resets, arms or holds."""
    scene.wire("enable")[302:] = 0.0
    scene.reacts(st.ENABLE_LOST, st.CUTS)
    scene.commands[[100, 300]] = st.RESET, st.STOP
    scene.commands[304:308] = st.RESET, st.ARM, st.HOLD, st.DISARM
    assert course(agreed(scene.recording()).rows) == [TRACKING, RAMPING, FAULT, OFF]


def test_creep_and_rate_dependence(scene, agreed):
    hysteresis = scene.axes["hysteresis"]
    hysteresis["creeps"], hysteresis["rate_cycles"] = 2, 0.5
    hysteresis["creep_gain"][:, :2], hysteresis["creep_step"][:, :2] = (0.05, 0.03), (0.01, 0.001)
    scene.commands[[200, 600]] = st.DISARM, st.ARM
    outcome = agreed(scene.recording())
    assert course(outcome.rows) == [TRACKING, RAMPING, READY, ARMING, TRACKING]
    assert np.all(outcome.state["axis"]["hysteresis"]["creep_um"][0, :, :2] != 0.0)


def test_jog(scene, agreed):
    reference = scene.axes["reference"]
    reference["kind"], reference["target_um"], reference["speed_um"], reference["smoothing"] = JOG, 30.0, 0.05, 0.02
    scene.commands[-200] = st.DISARM
    rows = agreed(scene.recording()).rows
    assert course(rows) == [TRACKING, RAMPING]
    assert rows["axis"]["reference_um"][-201, 0] == pytest.approx(30.0, abs=1.0)


def test_disagreement_names_the_number(tracking):
    from benchmarks.agreement import require_agreement
    from benchmarks.recording import Outcome, ours

    short = replace(tracking, signals=tracking.signals[:200])
    left, right = Outcome.room(200), Outcome.room(200)
    ours(short, left, 1)
    ours(short, right, 1)
    right.rows["axis"]["voltage_V"][7, 1] += 1e-6
    with pytest.raises(CheckFailed, match=r"rows\.axis\.voltage_V at \[7, 1\]"):
        require_agreement(left, right)


def test_twin_refuses_a_law_that_it_lacks(tracking):
    from benchmarks.twin import require_covered

    parameters = tracking.parameters.copy()
    parameters["axis"][0, 1]["feedback"] = 0
    with pytest.raises(CheckFailed, match="covers"):
        require_covered(parameters)
