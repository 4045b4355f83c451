"""The C twin of a tracking cycle does what our cycle does, with samples of any kind."""

import numpy as np
import pytest

from micromanip.errors import CheckFailed
from micromanip.rt.laws.estimator import INPUT_HISTORY
from micromanip.rt.states import TRACKING
from micromanip.settings.compile.limits import NEVER

from .scene import TRACKING_CYCLES

ANY_UM = 1e6
"""A set-point that may go so fast is never outrun: the controller tells of that, the twin does not."""

pytestmark = [pytest.mark.compiled_only, pytest.mark.long]


def test_tracking(tracking, agreed):
    outcome = agreed(tracking)
    assert np.all(outcome.rows["state"] == TRACKING)
    assert np.ptp(outcome.rows["axis"]["voltage_V"][:, 0]) > 1.0


def test_late_missing_and_false_samples_and_overruns(scene, tracking, agreed):
    """Sensors that report late, rarely, not at all for a while, or nonsense; some periods are skipped."""
    random = np.random.default_rng(4)
    cycles, signals = scene.cycles, scene.signals
    for role in ("strain", "stage", "deviation"):
        place = int(scene.axes[0][role])
        late = np.maximum.accumulate(np.maximum(np.arange(cycles) - random.integers(0, 12, cycles), 0))
        held = np.arange(cycles) // 3 * 3
        signals[:, place] = tracking.signals[late[held], place]
        signals["value"][random.integers(0, cycles, 40), place] = np.nan
        signals["value"][random.integers(0, cycles, 40), place] = 1e6
        signals["status"][random.integers(0, cycles, 40), place] = 1
        signals["time_ns"][:, place] -= random.integers(0, 99_000, cycles)
        signals[-1500:-1320, place] = signals[-1500, place]
    scene.forget_ages()
    # samples that nobody's voltages brought about, at times of their own: a filter that is not free loses its way there
    scene.axes["outer"]["innovation_um"] = scene.axes["outer"]["repeated_um"] = np.inf
    scene.axes["outer"]["gap_cycles"] = NEVER
    scene.axes["setpoint_slew_um"] = ANY_UM
    scene.p["score_cycles"] = TRACKING_CYCLES // 2
    scene.periods[random.integers(0, cycles, 30)] += random.integers(1, 4, 30)
    scene.periods[-200] = INPUT_HISTORY - 50
    outcome = agreed(scene.recording())
    axis = outcome.rows["axis"][:, 0]
    assert np.all(outcome.rows["state"] == TRACKING)
    assert axis["stage_age_ns"].max() > 10_000_000
    assert 0.1 < np.mean(axis["fresh"] & 2 > 0) < 0.5
    assert outcome.state["axis"]["reference"]["rejected"][0, 0] > 0
    assert outcome.state["axis"]["errors"][0, 0] > 0


def test_the_calm_gains_where_many_cycles_and_samples_are_missing(scene, agreed):
    """Both loops': the PID's fallback gains too, and back again."""
    scene.periods[300:420:4] += 3
    strain = scene.sensor("strain")
    for held in range(900, 1020, 15):
        strain[held : held + 12] = strain[held]
    scene.forget_ages()
    scene.axes["pid"]["most_periods"] = 2
    scene.axes["fallback"]["K_V_per_um"] = 0.4 * scene.axes["pid"]["K_V_per_um"]
    outcome = agreed(scene.recording())
    scene.axes["fallback"] = scene.axes["pid"]
    otherwise = agreed(scene.recording()).rows["axis"]["voltage_V"][:, :3]
    for first in (310, 910):
        apart = np.abs(outcome.rows["axis"]["voltage_V"][first : first + 100, :3] - otherwise[first : first + 100])
        assert (apart.max(axis=0) > 1e-3).all()


def test_joints_that_swing_at_another_frequency(scene, agreed):
    """Followed by all that the law has: with noise, and samples that are missing, so that slew and ends are met."""
    p = scene.axes["reference"]
    p["detuning_low"][:, 0], p["detuning_high"][:, 0] = -3.0, 4.0
    p["detuning_pull"][:, 0], p["detuning_slew"][:, 0], p["swing_floor_um2"][:, 0] = 40.0, 1.0, 0.01
    deviation = scene.sensor("deviation")
    deviation["value"] += 0.5 * np.random.default_rng(6).normal(size=scene.cycles)
    deviation["value"][700:900] = np.nan
    outcome = agreed(scene.recording())
    found = outcome.state["axis"]["reference"]["detuning"][0, :3, 0]
    assert np.all((found != 0.0) & (found >= -3.0) & (found <= 4.0))


def test_fault_shows_as_disagreement(scene, agreed):
    """The controller reacts, the twin only knows that something is."""
    scene.axes["watch"]["stage_samples"], scene.axes["watch"]["degraded_cycles"] = 3, 100
    scene.sensor("stage")[200:] = scene.sensor("stage")[200]
    with pytest.raises(CheckFailed, match="disagree"):
        agreed(scene.recording())


def _without_feedback(axis):
    axis["feedback"] = 0


def _with_a_notch(axis):
    axis["pid"]["notch_share"] = 0.9


def _awaiting(axis):
    axis["awaited_cycles"] = 2.5


def _without_a_resonance(axis):
    axis["hysteresis"]["resonances"] = 1


@pytest.mark.parametrize("changed", [_without_feedback, _with_a_notch, _awaiting, _without_a_resonance])
def test_twin_refuses_a_law_that_it_lacks(tracking, changed):
    from benchmarks.twin import require_covered

    parameters = tracking.parameters.copy()
    require_covered(parameters)
    changed(parameters["axis"][0, 1])
    with pytest.raises(CheckFailed, match="covers"):
        require_covered(parameters)
