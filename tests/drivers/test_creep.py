"""Creep of the simulated stack: the seed's figure, and nothing of it under integral action."""

import json
from dataclasses import replace

import numpy as np
import pytest
from micromanip_drivers.simulated.driver import SimulatedCell
from micromanip_drivers.simulated.options import Options

from micromanip.design.experiment import with_axes, with_reference
from micromanip.settings.schema.faults import AxisFaults, StrainInvalid
from micromanip.settings.schema.reference import Hold, Step
from micromanip.virtual.experiment import VirtualExperiment

from .simulated_bench import PERIOD_NS, quiet, tuned_cell

pytestmark = pytest.mark.long

SECONDS, EVERY = 26.0, 200


def course(mode, reference):
    """Time (s) and true strain of axis x from the beginning of tracking, without any noise."""
    given = tuned_cell()
    options = {**quiet(), "axes": ["x", "y", "z"]}
    driver = SimulatedCell(Options.model_validate_json(json.dumps(options)), PERIOD_NS)
    wired = replace(given, wiring=replace(given.wiring, drivers={"cell": driver}))
    faults = AxisFaults(strain=StrainInvalid(identical=None))  # without noise the gauge reads the same again and again
    configuration = with_reference(with_axes(given.configuration, mode=mode, faults=faults), reference)
    rows = VirtualExperiment(wired)(configuration, SECONDS, every=EVERY)
    return np.arange(1, len(rows) + 1) * EVERY * PERIOD_NS * 1e-9, rows["axis"]["true_strain_um"][:, 0]


def rate(t, position, at_s, half_s=1.0):
    near = np.abs(t - at_s) <= half_s
    return np.polyfit(t[near], position[near], 1)[0]


def test_creep_after_a_step_of_90_V():
    """It passes 0.02 um/s at about 18 s, and slows down as its logarithm does."""
    t, position = course("voltage", Step(source="step", offset_um=0.0, step_um=90.0))
    rates = {at: rate(t, position, at) for at in range(5, 26)}
    passed = next(at for at, value in rates.items() if value < 0.02)
    assert passed == pytest.approx(18.0, abs=3.0)
    assert rates[5] / rates[20] == pytest.approx(4.0, rel=0.35)  # 1/t
    assert all(value > 0.0 for value in rates.values())


def test_no_creep_under_integral_action():
    t, position = course("strain", Hold(source="hold", offset_um=90.0))
    assert abs(rate(t, position, 13.0, 12.0)) < 1e-5
    assert position[-1] == pytest.approx(90.0, abs=0.006)  # a step of the gauge's converter
