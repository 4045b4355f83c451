"""A gauge at rest whose readings do not change: dead, or coarser than its noise, as the configuration says."""

from types import SimpleNamespace

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.design.commission.polarity import check_rest
from micromanip.errors import CheckFailed
from micromanip.rt.records import MAX_AXES
from micromanip.settings.load import load

FACTORY = load(CONFIG / "factory.yaml")
STRAIN = FACTORY.faults.axis.strain


class Still:
    """An experiment in which the gauge reads `value_um`, a number or one for each cycle."""

    def __init__(self, value_um):
        self.value_um = value_um

    def __call__(self, configuration, seconds, samples):
        rows = np.zeros(len(samples), [("axis", [("strain_um", "f8"), ("fresh", "i8")], MAX_AXES)])
        rows["axis"]["strain_um"].T[:], rows["axis"]["fresh"] = self.value_um, 1
        return rows

    def path(self, configuration, axis):
        return SimpleNamespace(strain_cycles=1)


def cell(identical, range_um=(-30.0, 150.0)):
    axis_faults = FACTORY.faults.axis.model_copy(update={"strain": STRAIN.model_copy(update={"identical": identical})})
    signal = FACTORY.signals["strain_x"].model_copy(update={"range_um": range_um})
    return FACTORY.model_copy(
        update={
            "faults": FACTORY.faults.model_copy(update={"axis": axis_faults}),
            "signals": {**FACTORY.signals, "strain_x": signal},
        }
    )


def test_a_gauge_that_may_repeat_is_not_called_dead():
    check_rest(cell(None), Still(0.0), "x")


@pytest.mark.parametrize(
    ("identical", "value_um", "says"),
    [(20, 0.0, r"it is dead, .*strain\.identical: null says so"), (None, 150.0, "150 um .*, an end of its range")],
)
def test_a_gauge_without_noise_is_refused_with_what_it_may_be(identical, value_um, says):
    with pytest.raises(CheckFailed, match=says):
        check_rest(cell(identical), Still(value_um), "x")


def test_hum_and_noise_of_a_gauge_are_named_and_little_of_them_is_borne():
    """3000 cycles; 0.5 % of 126 um may be left at rest."""
    t, rng = 1e-4 * np.arange(3000), np.random.default_rng(1)
    check_rest(cell(None), Still(0.3 * np.sin(2 * np.pi * 50.0 * t) + rng.normal(0.0, 0.3, 3000)), "x")
    with pytest.raises(CheckFailed, match=r"strain gauge moves by 1\.4 um rms, most of it at 50 Hz: hum"):
        check_rest(cell(None), Still(2.0 * np.sin(2 * np.pi * 50.0 * t) + rng.normal(0.0, 0.06, 3000)), "x")
    with pytest.raises(CheckFailed, match=r"moves by [23](\.\d)? um rms, an open input .* at most 0\.63 um"):
        check_rest(cell(None), Still(rng.normal(0.0, 3.0, 3000)), "x")
