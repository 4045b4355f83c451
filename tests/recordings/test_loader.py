"""Gaps, jitter, cuts, rates, spikes and doubtful units: handled, and told."""

import numpy as np
import pytest
from host.test_mcap_recording import begun, slots
from hypothesis import given, settings
from hypothesis import strategies as st

from micromanip.design.data import counting, load_record
from micromanip.design.identify.linear.experiments import load_linear, split_at
from micromanip.errors import CheckFailed
from micromanip.recordings import Wanted, take
from micromanip.recordings.spikes import bridged, find_spikes
from micromanip.rt.telemetry import ROW

from .signals import SAMPLES, STEP_S, T, U, Y

COLUMNS = Wanted(("u", "y"))


def written(file, t=T, u=U, y=Y, header="t,u,y"):
    np.savetxt(file, np.column_stack([t, u, y]), "%.12g", ",", header=header, comments="")
    return file


def without(*samples):
    """The record with samples missing."""
    kept = np.delete(np.arange(SAMPLES), samples)
    return T[kept], U[kept], Y[kept]


def test_missing_samples_are_left_out_and_told(tmp_path):
    taken = take(written(tmp_path / "x.csv", *without(100, 300, 301, 302)), COLUMNS)
    assert taken.step_s == pytest.approx(STEP_S)
    assert [part.stop - part.start for part in taken.parts()] == [100, 199, SAMPLES - 303]
    np.testing.assert_array_equal(np.diff(taken.index)[[99, 298]], [2, 4])
    (note,) = taken.notes
    assert "4 samples are missing, in 2 gaps, the first before" in note
    assert "x.csv:102: " in note


def test_behind_a_longer_gap_the_burn_in_begins_again(tmp_path):
    record = load_record(written(tmp_path / "x.csv", *without(*range(300, 330))), COLUMNS)
    np.testing.assert_array_equal(np.flatnonzero(~counting(record, 20 * STEP_S)), [*range(20), *range(300, 350)])


def test_a_linear_record_takes_pieces_as_experiments(tmp_path):
    record = load_linear(written(tmp_path / "x.csv", *without(250, 300)), COLUMNS, 1)
    assert [len(u) for u, _ in record.experiments] == [250, SAMPLES - 301]
    np.testing.assert_allclose(record.experiments[1][1][:, 0], Y[301:], rtol=1e-9)
    assert any("1 of 3 parts between gaps are shorter than 100 samples" in note for note in record.notes)
    first, second = split_at(record, 0.5)
    assert [[len(u) for u, _ in part.experiments] for part in (first, second)] == [[250], [275]]
    often = written(tmp_path / "often.csv", *without(*range(0, SAMPLES, 20)))
    filled = load_linear(often, COLUMNS, 1)
    assert len(filled) == SAMPLES - 1
    np.testing.assert_allclose(filled.y, Y[1:], atol=0.05)
    assert any("of the missing samples 29, in gaps of at most 3, are filled in" in note for note in filled.notes)
    written(often, *without(*(k + n for k in range(0, SAMPLES, 20) for n in range(4))))
    with pytest.raises(CheckFailed, match="of 30 parts between gaps the longest has 16 samples, which is too short"):
        load_linear(often, COLUMNS, 1)


def recording(file, cycles):
    """A file as `run --record` makes it, of these cycles."""
    rows = np.zeros(len(cycles), ROW)
    rows["cycle"], rows["version"] = cycles, 1
    rows["axis"]["voltage_V"][:, 0] = U[: len(cycles)]
    rows["axis"]["strain_um"][:, 0] = Y[: len(cycles)]
    written = begun(file)
    for part in np.array_split(rows, 3):
        written.append(part, slots(1))
    written.close()


def test_a_recording_of_ours_with_skipped_cycles(tmp_path):
    cycles = 5000 + np.delete(np.arange(SAMPLES), [77])
    recording(tmp_path / "run.mcap", cycles)
    wanted = Wanted(("voltage_V_x", "strain_um_x"))
    record = load_record(tmp_path / "run.mcap", wanted)
    assert record.step_s == pytest.approx(1e-4)
    np.testing.assert_array_equal(np.flatnonzero(~counting(record, 0.0)), [77])
    assert "1 sample is missing before" in record.notes[0]
    assert len(load_linear(tmp_path / "run.mcap", wanted, 1).experiments) == 1  # the 77 before are too few
    assert take(tmp_path / "run.mcap", wanted).units == ("V", "um")


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), share=st.floats(0.02, 0.25))
def test_jittered_times_are_resampled_and_told(tmp_path_factory, seed, share):
    late = share * STEP_S * np.random.default_rng(seed).uniform(-1.0, 1.0, SAMPLES)
    t = T + late
    u, y = np.interp(t, T, U), np.interp(t, T, Y)
    taken = take(written(tmp_path_factory.mktemp("jitter") / "x.csv", t, u, y), COLUMNS)
    assert taken.step_s == pytest.approx(STEP_S, rel=1e-3)
    assert (np.diff(taken.index) == 1).all()
    at = t[0] + taken.index * taken.step_s
    np.testing.assert_allclose(taken.values[:, 0], np.interp(at, T, U), atol=0.02 * np.ptp(U))
    assert np.abs(taken.values[5:-5, 1] - np.interp(at, T, Y)[5:-5]).max() < 0.1
    assert any("jitters by" in note and "resampled evenly" in note for note in taken.notes)


def test_times_without_a_rate_are_refused_but_where_one_is_asked_for(tmp_path):
    t = np.sort(np.random.default_rng(3).uniform(0.0, 3.0, SAMPLES))
    file = written(tmp_path / "x.csv", t, np.interp(t, T, U), np.interp(t, T, Y))
    with pytest.raises(CheckFailed, match=r"t has no rate: its steps go from .* or choose one with --resample"):
        take(file, COLUMNS)
    taken = take(file, Wanted(("u", "y"), rate_hz=100.0))
    at = t[0] + taken.index * taken.step_s
    assert taken.step_s == pytest.approx(0.01)
    assert np.median(np.abs(taken.values[:, 0] - np.interp(at, T, U))) < 0.5


@pytest.mark.parametrize("rate_hz", [50.0, 77.0, 200.0, 1000.0])
def test_another_rate(rate_hz, tmp_path):
    taken = take(written(tmp_path / "x.csv"), Wanted(("u", "y"), rate_hz=rate_hz))
    assert taken.step_s == pytest.approx(1.0 / rate_hz)
    at = taken.index / rate_hz
    inside = (at > 0.3) & (at < T[-1] - 0.3)
    assert np.abs(taken.values[:, 0] - np.interp(at, T, U))[inside].max() < 0.1


def test_a_cut_is_in_seconds_from_the_first_sample(tmp_path):
    file = written(tmp_path / "x.csv", T + 1000.0)
    taken = take(file, Wanted(("u", "y"), cut=(0.5, 1.5)))
    np.testing.assert_allclose(taken.values[:, 0], U[100:300], rtol=1e-9)
    with pytest.raises(CheckFailed, match=r"--cut 7:9 leaves 0 samples: the recording goes from 0 to 2.995 s"):
        take(file, Wanted(("u", "y"), cut=(7.0, 9.0)))
    spoilt = Y.copy()
    spoilt[:3] = np.nan  # what is cut off need not be good
    assert len(take(written(file, y=spoilt), Wanted(("u", "y"), cut=(0.1, 1.0))).values) == 180


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    places=st.lists(st.integers(2, SAMPLES - 6), min_size=1, max_size=3, unique_by=lambda k: k // 20),
    size=st.floats(20.0, 1e4),
    length=st.integers(1, 3),
)
def test_spikes_are_found_where_they_are(seed, places, size, length):
    rng = np.random.default_rng(seed)
    x = Y + 0.05 * rng.standard_normal(SAMPLES)
    spoilt = x.copy()
    truth = np.zeros(SAMPLES, bool)
    for k in places:
        # the top of the signal could hide half of a small one
        spoilt[k : k + length] += size * rng.choice([-1.0, 1.0])
        truth[k : k + length] = True
    np.testing.assert_array_equal(find_spikes(spoilt), truth)
    assert np.abs(bridged(spoilt, truth) - x).max() < 6.0


@pytest.mark.parametrize(
    "signal",
    [
        np.random.default_rng(1).standard_normal(2000),
        np.sign(np.random.default_rng(2).standard_normal(2000)),
        np.repeat(np.random.default_rng(3).integers(0, 2, 200), 10).astype(float),
        np.round(Y),
        np.abs((np.arange(1000) % 100) - 50.0),
        np.where(np.arange(1000) < 500, 0.0, 1.0),
        np.zeros(50),
    ],
    ids=["noise", "binary", "slow binary", "coarse", "triangle", "step", "rest"],
)
def test_what_a_signal_does_by_itself_is_no_spike(signal):
    assert not find_spikes(signal).any()
