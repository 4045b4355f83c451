"""What a share of the feedback makes of noise and disturbance, held against a loop that is stepped."""

import numpy as np
import pytest
from scipy.signal import lfilter

from micromanip.design.quiet_loop import QuietLoop

RATE_HZ, SECONDS = 10_000.0, 16.0
HERTZ, NONE = np.arange(1.0, 3001.0), np.zeros(0)
GAIN, NOISE_UM = 0.2, 0.05
"""Of an integrator per cycle, on a plant that answers one cycle later."""


def loop(gain=GAIN):
    z = np.exp(2j * np.pi * HERTZ / RATE_HZ)
    return gain / (z - 1.0)


def stepped(gain, disturbance_um, mains_um=0.0):
    """Gauge and position (n,) of ``x+ = x - gain y + d+ - d``, ``y = x + noise``."""
    drawn = np.random.default_rng(1)
    count = round(SECONDS * RATE_HZ)
    noise = NOISE_UM * drawn.normal(size=count)
    noise += mains_um * np.sin(2.0 * np.pi * 50.0 * np.arange(count) / RATE_HZ)
    slow = lfilter([0.01], [1.0, -0.99], drawn.normal(size=count))
    d = disturbance_um * slow / slow.std()
    driven = np.diff(d, append=d[-1]) - gain * noise
    x = lfilter([0.0, 1.0], [1.0, gain - 1.0], driven)
    return x + noise, x


@pytest.mark.parametrize("disturbance_um", [0.0, 0.05])
def test_the_motion_under_each_share_is_what_the_gauge_tells_under_one(disturbance_um):
    quiet = QuietLoop.of(HERTZ, loop(), stepped(GAIN, disturbance_um)[0], RATE_HZ)
    for share in (1.0, 0.25, 0.0625):
        _, x = stepped(share * GAIN, disturbance_um)
        assert np.sqrt(quiet.motion_um2(share, NONE)) == pytest.approx(x.std(), rel=0.15, abs=1e-3), share


def test_less_feedback_is_quieter_where_there_is_only_noise_and_not_where_much_disturbs():
    alone, disturbed = (QuietLoop.of(HERTZ, loop(), stepped(GAIN, um)[0], RATE_HZ) for um in (0.0, 0.2))
    assert alone.motion_um2(0.0625, NONE) < alone.motion_um2(0.25, NONE) < alone.motion_um2(1.0, NONE)
    assert disturbed.motion_um2(0.0625, NONE) > disturbed.motion_um2(1.0, NONE)


def test_lines_of_the_mains_are_the_gauges_own_and_followed_where_they_are_not_learned():
    calm, humming = (QuietLoop.of(HERTZ, loop(), stepped(GAIN, 0.0, um)[0], RATE_HZ) for um in (0.0, 0.2))
    for share in (1.0, 0.0625):
        learned = humming.motion_um2(share, np.array([50.0, 100.0]))
        assert learned == pytest.approx(calm.motion_um2(share, NONE), rel=0.05)
        _, x = stepped(share * GAIN, 0.0, 0.2)
        assert np.sqrt(humming.motion_um2(share, np.array([150.0]))) == pytest.approx(x.std(), rel=0.1)


def test_a_share_that_is_not_stable_or_nearer_to_its_limit_is_not_borne():
    quiet = QuietLoop(HERTZ, loop(), np.ones(len(HERTZ)), 15)
    assert quiet.bears(1.0)
    assert quiet.bears(0.25)
    s = 2j * np.pi * HERTZ
    # stable with all gains, unstable with a tenth: gain is needed where the phase is beyond half a turn
    conditional = 2e6 * (1.0 + s / 500.0) ** 2 / (s * s * s) * 500.0
    assert np.abs(1.0 / (1.0 + conditional)).max() < 5.0
    assert not QuietLoop(HERTZ, conditional, np.ones(len(HERTZ)), 15).bears(0.1)
