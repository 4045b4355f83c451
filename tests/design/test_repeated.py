"""E of `evaluate`: what repeats of a sine's error goes, what does not stays, what is not known is left alone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from campaigns.simulated_cells import of_axes
from micromanip.design import measured_way, repeated
from micromanip.design.measured_way import MeasuredWay
from micromanip.design.repeated import Harmonics
from micromanip.virtual.experiment import VirtualExperiment

LINES = len(measured_way._LINES_HZ)
HERTZ = np.arange(10.0, 1000.0, 10.0)
KNOWN = MeasuredWay(np.ones(LINES, complex), np.ones(LINES, complex))


def way(off):
    """Whose amplitudes differ by `off` at 600 Hz, and as much more above."""
    return MeasuredWay(np.ones(LINES, complex), 1.0 + off * measured_way._LINES_HZ / 600.0 + 0j)


def test_what_is_known_ends_where_the_amplitudes_differ_by_a_fifth():
    assert way(0.01).highest_Hz == 3000.0
    assert way(0.4).highest_Hz == pytest.approx(300.0, abs=20.0)
    assert way(np.nan).highest_Hz == 0.0
    assert way(0.3).response(np.array([0.0, 600.0])) == pytest.approx([1.0, 1.2]), "the larger is the clearer one"


def test_beside_a_resonance_that_is_not_known_the_rest_is():
    large = np.ones(LINES, complex)
    large[(measured_way._LINES_HZ > 55.0) & (measured_way._LINES_HZ < 75.0)] = 2.0
    share = MeasuredWay(np.ones(LINES, complex), large).share(np.array([10.0, 45.0, 65.0, 72.0, 95.0, 300.0, 2900.0]))
    assert (share[[1, 2, 3]] == 0.0).all()
    assert share[[0, 4, 5]] == pytest.approx(1.0, abs=0.01)
    assert 0.0 < share[-1] < 0.5
    assert not way(np.nan).share(HERTZ).any()


def test_an_error_that_repeats_goes_though_the_way_is_another_than_was_measured():
    learns, true_way = Harmonics(HERTZ, KNOWN), 0.85 * np.exp(0.1j)
    wrong = np.where(np.isin(HERTZ, (10.0, 30.0, 150.0)), 0.3 + 0.1j, 0.0)
    drawn = np.random.default_rng(1)
    for _ in range(8):
        noise = 1e-3 * (drawn.normal(size=len(HERTZ)) + 1j * drawn.normal(size=len(HERTZ)))
        learns.learn(wrong + noise - true_way * learns.correction)
    left = np.abs(wrong - true_way * learns.correction)
    assert left[wrong != 0.0].max() < 0.05 * abs(0.3 + 0.1j)


def test_an_error_that_is_another_each_time_is_hardly_played():
    drawn, learns = np.random.default_rng(1), Harmonics(HERTZ, KNOWN)
    for _ in range(16):
        noise = drawn.normal(size=len(HERTZ)) + 1j * drawn.normal(size=len(HERTZ))
        learns.learn(noise - learns.correction)
    assert np.sqrt(np.mean(np.abs(learns.correction) ** 2)) < 0.1 * np.sqrt(2.0)


@given(st.lists(st.complex_numbers(max_magnitude=1e6), min_size=1, max_size=6), st.floats(0.0, 1.0))
def test_nothing_is_played_where_the_way_is_not_known(errors, off):
    learns = Harmonics(HERTZ, way(off))
    for error in errors:
        learns.learn(np.full(len(HERTZ), error))
    assert not learns.correction[way(off).highest_Hz < HERTZ].any()
    assert np.isfinite(learns.correction).all()


@pytest.mark.long
def test_sines_of_the_cell_need_little_feedback_and_the_mains_are_not_followed(monkeypatch):
    """Of 10 Hz the fifth harmonic is a line of the mains, which the gauge shows without any motion."""
    monkeypatch.setattr(repeated, "SINES", ((10.0, 30.0), (100.0, 10.0)))
    monkeypatch.setattr(measured_way, "_MEASURED_S", 4.0)
    prepared = of_axes("simulated.yaml", ["x"])
    for row in repeated.repeated(prepared.configuration, VirtualExperiment(prepared), 5):
        assert row["feedback_percent"] < 100.0
        assert row["true_std_error_um"] <= row["asked_true_std_error_um"], row
        repeats_um = np.sqrt(max(0.0, row["true_std_error_um"] ** 2 - row["floor_um"] ** 2))
        # followed, the mains would be .0071 of 10 Hz; what is above 400 Hz is .025 of 100 Hz
        assert repeats_um < {10.0: 0.006, 100.0: 0.012}[row["frequency_hz"]], row
