"""E of `evaluate`: what repeats of a sine's error goes, what does not stays, what is not known is left alone."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.design import repeated
from micromanip.design.repeated import Harmonics, MeasuredWay
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

CONFIG = Path(__file__).parents[2] / "config" / "simulated.yaml"
LINES = len(repeated._LINES_HZ)
HERTZ = np.arange(10.0, 1000.0, 10.0)
KNOWN = MeasuredWay(np.ones(LINES, complex), np.ones(LINES, complex))


def way(off):
    return MeasuredWay(np.ones(LINES, complex), 1.0 + off * np.linspace(0.0, 1.0, LINES) + 0j)


def test_what_is_known_ends_where_the_amplitudes_differ_by_a_fifth():
    assert way(0.1).highest_Hz == 600.0
    assert way(0.4).highest_Hz == pytest.approx(300.0, abs=10.0)
    assert way(np.nan).highest_Hz == 0.0
    assert way(0.1).response(np.array([0.0, 10.0, 600.0])) == pytest.approx([1.0, 1.0, 1.05])


def test_an_error_that_repeats_goes_though_the_way_is_another_than_was_measured():
    learns, true_way = Harmonics(HERTZ, KNOWN), 0.85 * np.exp(0.1j)
    wrong = np.where(HERTZ <= 150.0, 0.3 + 0.1j, 0.0)
    for _ in range(8):
        error = wrong - true_way * learns.correction
        learns.learn(error)
    left = np.abs(wrong - true_way * learns.correction)
    assert left[HERTZ <= 150.0].max() < 0.05 * abs(0.3 + 0.1j)


def test_an_error_that_is_another_each_time_is_hardly_played():
    drawn, learns = np.random.default_rng(1), Harmonics(HERTZ, KNOWN)
    for _ in range(16):
        noise = drawn.normal(size=len(HERTZ)) + 1j * drawn.normal(size=len(HERTZ))
        learns.learn(noise - learns.correction)
    assert np.sqrt(np.mean(np.abs(learns.correction) ** 2)) < 0.2 * np.sqrt(2.0)


@given(st.lists(st.complex_numbers(max_magnitude=1e6), min_size=1, max_size=6), st.floats(0.0, 1.0))
def test_nothing_is_played_where_the_way_is_not_known(errors, off):
    learns = Harmonics(HERTZ, way(off))
    for error in errors:
        learns.learn(np.full(len(HERTZ), error))
    assert not learns.correction[way(off).highest_Hz < HERTZ].any()
    assert np.isfinite(learns.correction).all()


@pytest.mark.long
def test_a_sine_of_the_cell_comes_near_to_what_does_not_repeat(monkeypatch):
    monkeypatch.setattr(repeated, "SINES", ((50.0, 10.0),))
    prepared = prepare(CONFIG)
    rows = {}
    for repetitions in (0, 3):
        experiment = VirtualExperiment(prepared)
        rows[repetitions] = repeated.repeated(prepared.configuration, experiment, repetitions)
    for before, after in zip(*rows.values(), strict=True):
        assert after["axis"] == before["axis"]
        repeats = [np.sqrt(max(0.0, row["true_std_error_um"] ** 2 - row["floor_um"] ** 2)) for row in (before, after)]
        assert repeats[1] < 0.7 * repeats[0], (before, after)
        assert after["true_rms_percent"] <= after["asked_true_rms_percent"]
