"""The family of drawn plants, the truth about them, and a plant that used to get false margins; the rest: campaign."""

import numpy as np
import pytest
from micromanip_drivers.simulated.options import BoucWen, Plant, SecondMode

from campaigns.drawn_plants import REACH_UM, drawn_cell, drawn_plant, small_slope, true_plant, with_plant
from campaigns.robustness import AXIS, CONFIG
from micromanip.design.experiment import open_loop, parked
from micromanip.design.identify.response import measure, multisine
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

CENTRE_V = 75.0
QUIET = {"strain_noise_nm": 1.0, "strain_hum_nm": 0.0, "creep_per_operator": 0.005, "damping": 0.02}


@pytest.fixture(scope="module")
def prepared():
    return prepare(CONFIG)


def test_drawn_plants_are_seeded_and_reach_far_enough(prepared):
    _, plant, reach = drawn_cell(prepared, AXIS, 15)
    _, same, again = drawn_cell(prepared, AXIS, 15)
    assert (plant, reach) == (same, again)
    assert REACH_UM[0] <= reach <= REACH_UM[1]
    assert drawn_plant(16) != drawn_plant(17)


@pytest.mark.parametrize(
    "plant",
    [
        Plant(**QUIET),
        Plant(**QUIET, second_mode=SecondMode(stiffness_share=0.4), late_cycles=2),
        Plant(**QUIET, bouc_wen=BoucWen()),
    ],
    ids=["plain", "second mode, late", "Bouc-Wen"],
)
def test_the_truth_is_what_the_simulation_does(prepared, plant):
    """Voltage to gauge of the linearised plant, its static gain apart: as a small multisine played.

    From 100 Hz on: a slow part of it sees the Bouc-Wen operator dithered by the fast ones, steeper than alone.
    """
    experiment = VirtualExperiment(with_plant(prepared, AXIS, plant, 1))
    wave = multisine(((2000.0, 1.0),), 30.0, 2000.0, 1e4, seed=1)
    samples = parked(prepared.configuration, len(wave.samples))
    samples[:, 0] = CENTRE_V + wave.samples
    rows = experiment(open_loop(prepared.configuration), len(samples) / 1e4, samples)["axis"]
    played = measure(wave, *(np.asarray(rows[name][:, 0], dtype=float) for name in ("voltage_V", "strain_um")))
    true = true_plant(plant, small_slope(plant, CENTRE_V), 1e-4).actuator().response(2 * np.pi * played.frequency_Hz)
    ratio = (played.response / true)[played.frequency_Hz > 100.0]
    middle = np.median(ratio.real)
    assert middle == pytest.approx(1.0, abs=0.1)
    assert np.median(np.abs(ratio / middle - 1.0)) < (0.05 if plant.bouc_wen else 0.02)
    assert np.quantile(np.abs(ratio / middle - 1.0), 0.95) < (0.2 if plant.bouc_wen else 0.08)
