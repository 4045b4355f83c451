"""Creep of the simulated actuator: there in open loop, gone under integral action."""

from pathlib import Path

import numpy as np

from micromanip.design.experiment import with_axes, with_reference
from micromanip.settings.check import prepare
from micromanip.settings.schema.reference import Hold, Step
from micromanip.virtual.experiment import VirtualExperiment

PREPARED = prepare(Path(__file__).parents[2] / "config" / "simulated.yaml")
SECONDS, EVERY = 40.0, 100


def true_position(configuration):
    """True position (um) of all axes, a row each 10 ms."""
    return VirtualExperiment(PREPARED)(configuration, SECONDS, every=EVERY)["axis"]["true_strain_um"]


def rate(position, around_s, width_s=2.0):
    """Slope (um/s) over `width_s` around a time."""
    first, last = round((around_s - width_s / 2) * 100), round((around_s + width_s / 2) * 100)
    return np.polyfit(np.arange(last - first) * 0.01, position[first:last], 1)[0]


def test_open_loop_creeps_as_in_the_paper():
    stepped = with_reference(
        with_axes(PREPARED.configuration, mode="voltage"), Step(source="step", offset_um=20.0, step_um=90.0)
    )
    position = true_position(stepped)
    # 0.02 um/s some tens of seconds after the step, less and less
    assert (rate(position, 10.0) > 0.02).all()
    assert (rate(position, 35.0) < 0.02).all()
    assert (rate(position, 35.0) > 0.005).all()


def test_integral_action_removes_it():
    held = with_reference(with_axes(PREPARED.configuration, mode="strain"), Hold(source="hold", offset_um=90.0))
    position = true_position(held)
    assert np.abs(position[100:].mean(axis=0) - 90.0).max() < 0.02
    assert np.abs(rate(position, 20.0, width_s=30.0)).max() < 0.0005  # a fortieth of what creeps in open loop
    assert np.abs(position[3000:].mean(axis=0) - position[100:1000].mean(axis=0)).max() < 0.01
