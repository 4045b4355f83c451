"""The C twin of the cycle does what our cycle does: arming, tracking, holds and stops, samples of any kind."""

from dataclasses import replace

import numpy as np
import pytest

from micromanip.errors import CheckFailed
from micromanip.rt import states as st
from micromanip.rt.records import INPUT_HISTORY
from micromanip.rt.reference import JOG
from micromanip.rt.states import ARMED, HOLDING, OFF, RAMPING, READY, TRACKING
from micromanip.settings.limits import NEVER

from .scene import TRACKING_CYCLES, Scene, course

pytestmark = pytest.mark.compiled_only


def test_arming_and_tracking(arming, agreed):
    outcome = agreed(arming)
    rows = outcome.rows
    assert course(rows) == [READY, ARMED, TRACKING]
    assert list(rows["state"][[-TRACKING_CYCLES - 1, -TRACKING_CYCLES]]) == [ARMED, TRACKING]
    assert outcome.state["checked"][0] == 1
    assert np.ptp(rows["axis"]["voltage_V"][-TRACKING_CYCLES:, 0]) > 1.0


def test_late_missing_and_false_samples_and_overruns(arming, agreed):
    """Sensors that report late, rarely, not at all for a while, or nonsense; some periods are skipped."""
    random = np.random.default_rng(4)
    scene = Scene(arming)
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
    for age in ("strain_age_ns", "stage_age_ns", "reference_age_ns"):
        scene.axes[age] = NEVER
    scene.p["score_cycles"] = TRACKING_CYCLES // 2
    periods = arming.periods.copy()
    periods[random.integers(start, cycles, 30)] += random.integers(1, 4, 30)
    periods[-200] = 2 * INPUT_HISTORY
    outcome = agreed(replace(scene.recording(), periods=periods))
    axis = outcome.rows["axis"][:, 0]
    assert outcome.rows["state"][-1] == TRACKING
    assert axis["stage_age_ns"].max() > 10_000_000
    assert 0.1 < np.mean(axis["fresh"][start:] & 2 > 0) < 0.5
    assert outcome.state["axis"]["reference"]["rejected"][0, 0] > 0
    assert outcome.state["axis"]["errors"][0, 0] > 0


def test_hold_and_resume(scene, agreed):
    """A soft stop follows, and a second start, which needs no check."""
    scene.commands[200], scene.commands[400] = st.HOLD, st.ARM
    scene.commands[700], scene.commands[1100] = st.DISARM, st.ARM
    outcome = agreed(scene.recording())
    rows = outcome.rows
    assert course(rows) == [TRACKING, HOLDING, ARMED, TRACKING, RAMPING, READY, ARMED, TRACKING]
    assert np.count_nonzero(rows["state"] == RAMPING) >= 100 + 150
    assert outcome.state["axis"]["errors"][0, 0] > 0


@pytest.mark.parametrize("before", [None, st.HOLD, st.DISARM])
def test_stop(scene, agreed, before):
    scene.commands[300] = st.STOP
    if before is not None:
        scene.commands[250] = before
    rows = agreed(scene.recording()).rows
    assert course(rows)[-2:] == [RAMPING, OFF]


def test_jog(scene, agreed):
    reference = scene.axes["reference"]
    reference["kind"], reference["target_um"], reference["speed_um"], reference["smoothing"] = JOG, 30.0, 0.05, 0.02
    rows = agreed(scene.recording()).rows
    assert course(rows) == [TRACKING]
    assert rows["axis"]["reference_um"][-1, 0] == pytest.approx(30.0, abs=1.0)


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
