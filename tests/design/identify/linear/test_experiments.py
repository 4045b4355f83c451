"""What is short and true is kept for a linear fit: blows, answers, a start that is no rest; faults are bridged."""

import numpy as np
import pytest
from scipy.signal import lfilter

from micromanip.design.identify.linear.experiments import clipped, load_linear
from micromanip.design.identify.linear.validated import coherence_of, fit_records
from micromanip.recordings import Wanted

COUNT = 4000
PHASE = 2 * np.pi * 10 * np.arange(COUNT) / COUNT


def ringing(u):
    return lfilter([0.0, 0.0, 0.0, 0.01], [1.0, -1.98, 0.985], u)


@pytest.fixture
def noise():
    return np.random.default_rng(1).standard_normal(COUNT)


def found(u, y):
    return clipped(u[:, None], y)


@pytest.mark.parametrize("behind", [0.0, 3e-4], ids=["in the converter", "before its noise"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_clipped_output_is_told_of(noise, sign, behind):
    u = np.sin(PHASE) + 0.5 * np.sin(3.3 * PHASE)
    y = sign * ringing(u)
    y = np.minimum(y, np.quantile(y, 0.9))
    assert found(u, y + behind * np.ptp(y) * noise).startswith("sticks at its top value ")
    assert found(u, -y + behind * np.ptp(y) * noise).startswith("sticks at its bottom value ")


@pytest.mark.parametrize("codes", [0, 3, 50, 1000])
@pytest.mark.parametrize("lag", [0.0, 0.5, 1.0, 1.5])
def test_slow_peaks_are_not_clipped(lag, codes):
    """Whatever the phase, and however coarse the converter."""
    y = np.sin(PHASE - np.pi * lag)
    assert found(np.sin(PHASE), np.round(codes * y) if codes else y) is None


@pytest.mark.parametrize("gain", [1.0, -1.0])
def test_what_settles_behind_steps_is_not_clipped(noise, gain):
    u = np.sign(np.sin(PHASE))
    y = gain * lfilter([0.1], [1.0, -0.9], np.roll(u, 30))
    assert found(u, y) is None
    assert found(u + 0.01 * noise, y) is None


@pytest.mark.parametrize("noise", [0.0, 0.1, 1.0, 5.0])
def test_coherence_is_the_share_of_the_power_that_the_inputs_explain(noise):
    """Two inputs that are correlated, white noise on each output: ``1 / (1 + noise^2)`` of its power is explained.

    Of the noise two inputs explain two in sixteen averages, more where these overlap.
    """
    rng = np.random.default_rng(3)
    parts = []
    for _ in range(3):
        u = rng.normal(size=(20_000, 2)) @ np.array([[1.0, 0.6], [0.0, 0.8]])
        y = u @ np.array([[1.0, 0.2], [-0.5, 1.0]])
        parts.append((u, y + noise * y.std(axis=0) * rng.normal(size=y.shape)))
    share = 1.0 / (1.0 + noise**2)
    found = coherence_of(parts)
    assert (found >= share - 0.01).all()
    assert (found <= share + (1.0 - share) * 2 / 16 + 0.01).all()


RATE_HZ, SAMPLES = 5000.0, 10000
WANTED = Wanted(("force", "stage"))
DECAY = 2 * np.pi * 180.0 / RATE_HZ * np.array([0.02, np.sqrt(1 - 0.02**2)])
MODE = [1.0, -2.0 * np.exp(-DECAY[0]) * np.cos(DECAY[1]), np.exp(-2.0 * DECAY[0])]


def blows(width, seed=3):
    """A hammer's blows, half sines of `width` samples, on a mode at 180 Hz, with noise of both sensors."""
    rng = np.random.default_rng(seed)
    u = np.zeros(SAMPLES)
    for k in range(200, SAMPLES, 1250):
        u[k : k + width] += (80 + 40 * rng.random()) * np.sin(np.pi * (np.arange(width) + 0.5) / width)
    y = lfilter([0.0, 0.05], MODE, u) + 0.002 * rng.standard_normal(SAMPLES)
    return u + 0.01 * rng.standard_normal(SAMPLES), y


def written(file, u, y):
    table = np.column_stack([np.arange(len(u)) / RATE_HZ, u, y])
    np.savetxt(file, table, "%.7g", ",", header="t_s,force,stage", comments="")
    return file


@pytest.mark.parametrize("width", [1, 2, 3, 8])
def test_blows_and_their_answers_are_no_spikes(width, tmp_path):
    result = fit_records([load_linear(written(tmp_path / "x.csv", *blows(width)), WANTED)], None, None, 0.5)
    assert result.fit_percent[0] > 99.0
    natural_Hz = np.abs(np.log(result.model.poles)) * RATE_HZ / (2 * np.pi)
    assert np.abs(natural_Hz - 180.0).min() < 0.2


@pytest.mark.parametrize("column", [0, 1])
def test_faults_among_blows_are_bridged_or_kept_as_asked(column, tmp_path):
    signals, true = blows(8), blows(8)
    signals[column][[1000, 4000, 7001]] += 300.0
    file = written(tmp_path / "x.csv", *signals)
    record = load_linear(file, WANTED)
    spread = np.ptp(true[column])
    assert np.abs((record.u, record.y)[column] - true[column]).max() < 0.1 * spread
    assert any(f"at {file}:" in note and "bridged, and not fitted to (--keep-spikes" in note for note in record.notes)
    kept = load_linear(file, Wanted(("force", "stage"), bridge=False))
    np.testing.assert_allclose((kept.u, kept.y)[column], signals[column], atol=1e-4)
    assert not kept.notes


@pytest.mark.parametrize("samples", [220, 999, 1000, 1001, 1002])
def test_a_fault_in_a_short_record_is_bridged(samples, tmp_path):
    u = np.random.default_rng(2).standard_normal(samples)
    y = lfilter([0.0, 0.1], [1.0, -1.6, 0.8], u)
    spoilt = y.copy()
    spoilt[150] += 20.0
    record = load_linear(written(tmp_path / "x.csv", u, spoilt), WANTED)
    assert np.abs(record.y - y).max() < 0.5


def test_a_record_that_does_not_begin_at_rest_is_kept(tmp_path):
    rng = np.random.default_rng(1)
    u = np.repeat(rng.standard_normal(200), 20)
    rest = lfilter([0.0, 0.1], [1.0, -0.9], u) + 0.001 * rng.standard_normal(4000)
    y = rest + 60.0 * 0.4 ** np.arange(4000)
    record = load_linear(written(tmp_path / "x.csv", u, y), WANTED)
    np.testing.assert_allclose(record.y, y, rtol=1e-5, atol=1e-6)
