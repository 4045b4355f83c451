"""The injected multisine: its lines and nothing else, smooth ends, and no more of it where it may not be."""

import numpy as np
import pytest

from micromanip.control.injection import injection
from micromanip.rt.laws.excitation import EXCITATION_PARAMETERS, EXCITATION_STATE

from .builders import record
from .kernels import excitation_course

RATE_HZ = 1_000.0
WAVE = injection(0.5, 300.0, RATE_HZ, lines=10, seed=3)


def parameters(number=1, stop=False):
    p = record(EXCITATION_PARAMETERS)
    WAVE.fill(p, number, stop=stop)
    return p


def course(p, cycles, s=None, allowed=None):
    out = np.zeros(len(cycles))
    s = record(EXCITATION_STATE) if s is None else s
    excitation_course(p, s, np.asarray(cycles), np.ones(len(cycles), bool) if allowed is None else allowed, out)
    return out


def test_whole_periods_hold_the_lines_that_were_asked_for_and_nothing_else():
    whole = course(parameters(), 7000 + np.arange(WAVE.cycles + 100))
    one = whole[WAVE.first_cycle :][: WAVE.period_cycles]
    spectrum = np.fft.rfft(one) / (0.5 * WAVE.period_cycles)
    turned = np.exp(1j * (WAVE.phase + 2 * np.pi * WAVE.harmonic * WAVE.first_cycle / WAVE.period_cycles))
    assert spectrum[WAVE.harmonic] == pytest.approx(WAVE.amplitude * turned, abs=1e-9)
    spectrum[WAVE.harmonic] = 0.0
    assert np.abs(spectrum).max() < 1e-9
    assert one.std() == pytest.approx(0.5, rel=1e-6)
    assert np.abs(one).max() == pytest.approx(WAVE.peak, rel=1e-9)


def test_it_begins_and_ends_at_zero_without_a_step():
    whole = course(parameters(), np.arange(WAVE.cycles + 100))
    assert np.abs(whole[[0, *range(WAVE.cycles, WAVE.cycles + 100)]]).max() < 1e-4 * WAVE.peak
    assert np.abs(np.diff(whole)).max() <= 1.02 * WAVE.fastest
    for end in (whole[:10], whole[WAVE.cycles - 10 : WAVE.cycles]):
        assert np.abs(end).max() < 1e-2 * WAVE.peak


def test_a_stop_fades_out():
    s = record(EXCITATION_STATE)
    before = course(parameters(), np.arange(600), s)
    after = course(parameters(stop=True), np.arange(600, 900), s)
    assert abs(after[0] - before[-1]) <= 1.02 * WAVE.fastest
    assert np.abs(np.diff(after)).max() <= 1.02 * WAVE.fastest
    assert np.abs(after[WAVE.fade_cycles :]).max() == 0.0


def test_where_it_may_not_be_it_is_over_at_once_and_for_good():
    allowed = np.ones(800, bool)
    allowed[500:503] = False
    s = record(EXCITATION_STATE)
    out = course(parameters(), np.arange(800), s, allowed)
    assert np.abs(out[400:500]).max() > 0.1
    assert np.abs(out[500:]).max() == 0.0
    assert np.abs(course(parameters(number=2), np.arange(800, 1400), s)).max() > 0.1, "the next one is another"


@pytest.mark.parametrize("high_Hz", [3000.0, 200.0])
def test_lines_keep_away_from_hum_and_the_crest_is_low(high_Hz):
    wave = injection(1.0, high_Hz, 10_000.0, seed=1)
    hertz = wave.frequency_Hz
    assert len(hertz) >= 45
    assert hertz.max() <= high_Hz * 1.01
    assert wave.peak < 4.0
    for mains in (50.0, 60.0):
        assert np.abs(hertz - mains * np.round(hertz / mains)).min() > 0.3


def test_spectra_survive_missed_cycles_and_refuse_many():
    cycle = np.arange(WAVE.cycles)
    played = course(parameters(), cycle)
    signals = np.column_stack([played, 2.0 * np.roll(played, 3) + 0.01 * cycle / WAVE.cycles])
    U, Y = WAVE.spectra(cycle, signals)
    late = 2.0 * np.exp(-2j * np.pi * WAVE.harmonic * 3 / WAVE.period_cycles)
    assert Y / U == pytest.approx(np.tile(late, (len(U), 1)), rel=1e-3)
    few = np.delete(cycle, np.arange(900, 905))
    assert (WAVE.spectra(few, signals[few])[0] / U) == pytest.approx(np.ones(U.shape), abs=0.3)
    many = np.delete(cycle, np.arange(900, 900 + int(0.06 * 5 * WAVE.period_cycles)))
    with pytest.raises(ValueError, match=r"6.0 % of the cycles were missed, at most 5 % may be"):
        WAVE.spectra(many, signals[many])
    with pytest.raises(ValueError, match="does not cover"):
        WAVE.spectra(cycle[:2000], signals[:2000])
