"""Lines told from noise, hum and resonances; the reference that is made of what the tracker said at rest."""

import numpy as np
import pytest
from scipy.signal import lfilter

from campaigns.report import CONFIG
from micromanip.design.commission.quiescent_spectrum import (
    FLANK_SHARE,
    STANDS_OUT,
    look_at_rest,
    strongest_line,
    tooth_at_work,
)
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment, with_options

FACTORY = CONFIG / "factory.yaml"

RATE_HZ, BAND_HZ = 10_000.0, (70.0, 1000.0)
T_S = np.arange(50_000) / RATE_HZ
NOISE = np.random.default_rng(7).normal(0.0, 0.02, len(T_S))


@pytest.mark.parametrize("hertz", [83.3, 200.0, 417.62, 900.0])
def test_a_line_is_found_with_its_frequency_and_size(hertz):
    found, size_um, ratio = strongest_line(NOISE + 0.5 * np.sin(2 * np.pi * hertz * T_S), RATE_HZ, BAND_HZ)
    assert found == pytest.approx(hertz, abs=0.1)
    assert size_um == pytest.approx(0.5, rel=0.2), "between two bins of a Hann window 15 % are lost"
    assert ratio > 50.0


def swinging_stage(hertz, damping, seed):
    """`T_S` of a mode that noise excites, rms 1 um, past its beginning."""
    pole = np.exp((-damping + 1j * np.sqrt(1.0 - damping**2)) * 2 * np.pi * hertz / RATE_HZ)
    excited = np.random.default_rng(seed).standard_normal(2 * len(T_S))
    swinging = lfilter([1.0], np.poly([pole, pole.conj()]).real, excited)[len(T_S) :]
    return swinging / swinging.std()


@pytest.mark.parametrize("damping", [0.02, 0.01, 0.007])
def test_a_mode_of_the_flexure_is_no_tooth_and_hides_none(damping):
    """A lightly damped mode near 72 Hz, as a strain loop leaves it, stands out of what is 2 to 12 Hz beside it."""
    swinging = [swinging_stage(72.0, damping, seed) for seed in range(8)]
    ratios = [strongest_line(y, RATE_HZ, BAND_HZ, flank_share=FLANK_SHARE)[2] for y in swinging]
    assert max(ratios) < STANDS_OUT
    if damping < 0.01:
        assert max(strongest_line(y, RATE_HZ, BAND_HZ)[2] for y in swinging) > STANDS_OUT, "else it asks for nothing"
    for hertz in (79.4, 190.5, 800.4):
        turns = np.cumsum(hertz * (1.0 + 0.0025 * np.sin(2 * np.pi * 0.7 * T_S))) / RATE_HZ
        cut = swinging[0] + 3.0 * np.sin(2 * np.pi * turns)
        found, _, ratio = strongest_line(cut, RATE_HZ, BAND_HZ, flank_share=FLANK_SHARE)
        assert ratio > STANDS_OUT, "a spindle whose speed wanders by a quarter of a percent"
        assert found == pytest.approx(hertz, rel=0.004)


@pytest.mark.long
def test_a_tooth_is_found_where_the_axis_works_when_its_parked_stage_is_out_of_the_sensors_range():
    """Parked, this stage rests 300 um from where it works: a sensor that reads +-150 um shows the tooth there only."""
    prepared = prepare(FACTORY)
    driver = prepared.wiring.drivers["cell"]

    def cell(tooth_N):
        plant = driver.options.plant.model_copy(update={"stage_range_um": 150.0})
        force = driver.options.force.model_copy(update={"tooth_N": tooth_N, "tooth_Hz": 237.0})
        options = driver.options.model_copy(update={"plant": plant, "variation": {}, "force": force})
        return VirtualExperiment(with_options(prepared, "cell", options), process=True)

    assert look_at_rest(prepared.configuration, cell(40.0)).tooth_Hz is None
    hertz, um = tooth_at_work(prepared.configuration, cell(40.0), "y")
    assert hertz == pytest.approx(237.0, abs=0.1)
    assert um > 0.5
    assert tooth_at_work(prepared.configuration, cell(0.0), "y") is None


def test_the_mains_are_no_tooth():
    hum = NOISE + np.sin(2 * np.pi * 100.0 * T_S) + 0.1 * np.sin(2 * np.pi * 333.0 * T_S)
    assert strongest_line(hum, RATE_HZ, BAND_HZ)[0] == pytest.approx(333.0, abs=0.1)
