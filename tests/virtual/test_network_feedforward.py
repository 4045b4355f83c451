"""From a recording of random turning points to a network in the loop: as good as the tanh model it stands in for."""

from pathlib import Path

import pytest

from micromanip.design import paper
from micromanip.design.evaluation import Run
from micromanip.design.experiment import with_axes, with_axis, with_reference
from micromanip.design.identification import design, recording, samples_for, variant
from micromanip.design.network import smoothed
from micromanip.design.network_fit import fit_network
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

CONFIG = Path(__file__).parents[2] / "config"


def sigmas_um(prepared, configuration):
    """Sigma of configuration C on axis x at 5 and 10 Hz, where a wrong slope shows."""
    inner = paper.ANCHOR_PID.model_copy(update={"mode": "pid+feedforward"})
    moving = with_axes(configuration, mode="strain", inner=inner, actuator=None)
    out = []
    for frequency_hz in (5.0, 10.0):
        rows = VirtualExperiment(prepared)(with_reference(moving, paper.reference(frequency_hz, 0.5)), 2.5)
        out.append(Run("C", frequency_hz, rows[5000:], 10_000, 10_000).figures("x", 0)["std_error_um"])
    return out


@pytest.mark.thorough  # the fit, and the loop that repeats it: tests/design/test_network.py
def test_network_in_the_loop():
    factory = prepare(CONFIG / "factory.yaml")
    configuration = factory.configuration
    excitation = design(configuration, "x", "turns", 24.0, seed=1)
    duration_s = len(excitation.samples) / configuration.loop.rate_hz
    rows = VirtualExperiment(factory)(variant(configuration), duration_s, samples_for(configuration, excitation))
    columns = recording(configuration, excitation, rows)
    network = fit_network(smoothed(columns["strain_um"]), columns["voltage_V"], starts=2, burn_in=1000)

    tuned = prepare(CONFIG / "simulated.yaml")
    model = network.to_settings(tuned.configuration.axes["x"].setpoint.range_um)
    with_network = sigmas_um(tuned, with_axis(tuned.configuration, "x", hysteresis=model))
    with_tanh = sigmas_um(tuned, tuned.configuration)
    assert with_network == pytest.approx(with_tanh, rel=0.2)
