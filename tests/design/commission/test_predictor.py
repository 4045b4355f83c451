"""Which axes get a predictor of their own from what the tracker said at rest: where samples held out gain by it."""

import numpy as np
import pytest

from micromanip.control.joints import joints_radius
from micromanip.control.predictor import output_row, reference_transition, tracker_gain
from micromanip.design.commission.predictor import known_deviations
from micromanip.design.commission.production import in_production
from micromanip.design.commission.quiescent_spectrum import AtRest
from micromanip.design.experiment import with_axes
from micromanip.settings.schema.reference import Hold, Steady

from .test_production import TUNED

RATE_HZ, NOISE_UM = 400.0, 0.5
T_S = np.arange(4000) / RATE_HZ


def moving(seed, amplitude_um=80.0):
    """A robot on its path, with joints that swing at 7.76 Hz."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    path = amplitude_um * np.sin(2 * np.pi * 0.31 * T_S + phases[0]) + 20.0 * np.sin(2 * np.pi * 0.83 * T_S + phases[1])
    return path + 30.0 * np.sin(2 * np.pi * 7.76 * T_S + phases[2]) + rng.normal(0.0, NOISE_UM, len(T_S))


def still(seed):
    return np.random.default_rng(seed).normal(0.0, NOISE_UM, len(T_S))


def seen(**samples):
    return AtRest(RATE_HZ, NOISE_UM, 8.0, None, deviation_um=samples)


def predicted(tracker, samples):
    """Rms (um) of what the predictor of `tracker` expects a sample later, less the samples."""
    gain, step = tracker_gain(tracker), reference_transition(tracker.oscillations, 1.0 / RATE_HZ)
    state, row, left = np.zeros(len(gain)), output_row(len(gain)), []
    state[0] = samples[0]
    for sample in samples[1:]:
        state = step @ state
        left.append(sample - row @ state)
        state = state + gain * left[-1]
    return np.sqrt(np.mean(np.square(left[len(left) // 2 :])))


@pytest.mark.long
def test_an_axis_on_its_path_gets_one_that_is_better_on_another_day():
    rest = seen(y=moving(1))
    unfollowed = with_axes(TUNED, mode="strain").model_copy(update={"reference": Hold(source="hold", offset_um=66.0)})
    production = in_production(unfollowed, rest)
    own, reference = production.configuration.reference, rest.reference()
    found = own.axes
    assert found.keys() == {"y"}
    assert found["y"].oscillations[0].frequency_Hz == pytest.approx(7.76, rel=0.002)
    assert found["y"].noise_um == pytest.approx(NOISE_UM, rel=0.1)
    assert production.decided[-1].startswith("The predictor of axis y has its own noise")
    another = moving(2)
    assert predicted(own.of("y"), another) < 0.85 * predicted(reference.of("y"), another)


@pytest.mark.long
def test_of_a_robot_that_hardly_moves_only_the_oscillation_is_sure():
    """The narrow predictor takes the path for as rough as it is said to be of all axes."""
    drift = 8.0 * np.sin(2 * np.pi * 0.31 * T_S) + 4.0 * np.sin(2 * np.pi * 0.83 * T_S)
    rest = seen(x=still(3) + drift + 30.0 * np.sin(2 * np.pi * 7.76 * T_S))
    found, _ = known_deviations(rest.reference(), rest)
    assert found["x"].jerk_um_per_s3 is None
    assert found["x"].steady == Steady()
    tracker = rest.reference().model_copy(update={"axes": found}).of("x")
    assert tracker.sure.jerk_um_per_s3 == tracker.jerk_um_per_s3
    assert tracker.sure.oscillations[0].um_per_s < tracker.oscillations[0].um_per_s
    assert joints_radius(tracker.sure) < 1.0


def test_a_tracker_that_says_nothing_leaves_everything_as_it_was():
    rest = seen(x=np.zeros(4000))
    found, (sentence,) = known_deviations(rest.reference(), rest)
    assert found == {}
    assert "is the tracker connected?" in sentence
