"""What the analysis says of a strain loop with a notch is what the loop does in virtual time."""

import numpy as np
import pytest

from micromanip.design.analyse.loops import strain_loop
from micromanip.design.experiment import with_axes, with_reference
from micromanip.design.identify.actuation import identify_actuator
from micromanip.settings.check import prepare
from micromanip.settings.schema.axis import Notch
from micromanip.settings.schema.reference import Sine, Sines
from micromanip.virtual.experiment import VirtualExperiment

from .protected import PAPER

pytestmark = pytest.mark.compiled_only
NOTCH = Notch(frequency_Hz=150.0, width_Hz=60.0, depth_percent=90.0)


@pytest.fixture(scope="module")
def cell():
    prepared = prepare(PAPER)
    experiment = VirtualExperiment(prepared)
    return prepared.configuration, experiment, identify_actuator(prepared.configuration, experiment, "x")


def with_notch(inner, notch):
    return inner.model_copy(update={"notch": notch, "mode": "pid"})


def measured(cell, inner, frequency_Hz):
    """Error over set-point at `frequency_Hz`, and what the notch takes over the error that it gets, as sizes."""
    configuration, experiment, _ = cell
    sine = Sines(source="sine", offset_um=66.0, sines=(Sine(amplitude_um=1.0, frequency_Hz=frequency_Hz),))
    rows = experiment(with_reference(with_axes(configuration, mode="strain", inner=inner), sine), 1.0)
    late = rows["axis"][len(rows) // 2 :, 0]
    t = np.arange(len(late)) / configuration.loop.rate_hz
    turn = np.exp(-2j * np.pi * frequency_Hz * t)
    error, setpoint, taken = (
        abs(np.mean(turn * (values - values.mean())))
        for values in (late["setpoint_um"] - late["strain_um"], late["setpoint_um"], late["notch_um"])
    )
    return error / setpoint, taken / error


@pytest.mark.parametrize("frequency_Hz", [40.0, 110.0, 150.0, 250.0])
def test_the_sensitivity_is_as_predicted(cell, frequency_Hz):
    """Within 10 %; without the notch it would be far off at its centre, where 90 % of the error is taken out."""
    configuration, _, actuator = cell
    inner = with_notch(configuration.axes["x"].inner, NOTCH)
    omega = np.array([2 * np.pi * frequency_Hz])
    with_it, without = (
        1.0 / abs(1.0 + strain_loop(each, actuator.system).response(omega)[0])
        for each in (inner, with_notch(inner, None))
    )
    error, taken = measured(cell, inner, frequency_Hz)
    assert error == pytest.approx(with_it, rel=0.1)
    if frequency_Hz == NOTCH.frequency_Hz:
        assert taken == pytest.approx(0.9, rel=0.02)
        assert abs(with_it / without - 1.0) > 0.25
