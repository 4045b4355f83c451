"""Excitations stay inside the output's limits, begin and end softly, and only the chosen axis moves."""

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.design.experiment import open_loop
from micromanip.design.identify.experiments import design, recording, samples_for, write_csv
from micromanip.rt.states import TRACKING
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

FACTORY = CONFIG / "factory.yaml"
KINDS = ("multisine", "turns", "triangle", "step")


@pytest.fixture(scope="module")
def prepared():
    return prepare(FACTORY)


def with_output(prepared, **updates):
    """The configuration with another output of axis x."""
    configuration = prepared.configuration
    output = configuration.outputs["voltage_x"].model_copy(update=updates)
    return configuration.model_copy(update={"outputs": configuration.outputs | {"voltage_x": output}})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "limits",
    [{}, {"slew_V_per_ms": 0.3}, {"range_V": (0.0, 60.0), "park_V": 10.0}],
    ids=["factory", "slew", "range"],
)
def test_excitations_respect_the_output(prepared, kind, limits):
    configuration = with_output(prepared, **limits)
    output, rate = configuration.outputs["voltage_x"], configuration.loop.rate_hz
    whole = design(configuration, "x", kind, 3.0, seed=1).samples
    assert whole.min() >= output.range_V[0]
    assert whole.max() <= output.range_V[1]
    assert whole[0] == pytest.approx(output.park_V)
    assert whole[-1] == pytest.approx(output.park_V)
    assert np.abs(np.diff(whole)).max() * rate <= output.slew_V_per_ms * 1e3


def test_the_others_rest_at_their_park_voltage(prepared):
    configuration = with_output(prepared, park_V=12.0)
    samples = samples_for(configuration, design(configuration, "y", "multisine", 2.0, 1))
    assert (samples[:, 0] == 12.0).all()
    assert np.ptp(samples[:, 1]) > 50.0
    assert (samples[:, 2:] == 0.0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_experiment_in_virtual_time(prepared, kind, tmp_path):
    configuration = prepared.configuration
    excitation = design(configuration, "y", kind, 2.0, 1)
    duration_s = len(excitation.samples) / configuration.loop.rate_hz
    rows = VirtualExperiment(prepared)(open_loop(configuration), duration_s, samples_for(configuration, excitation))
    assert (rows["state"] == TRACKING).all()
    assert (rows["fault"] == 0).all()
    voltage = rows["axis"]["voltage_V"]
    assert np.abs(voltage[:, [0, 2]]).max() <= 1e-6, "the other axes stay parked"
    output = configuration.outputs["voltage_y"]
    assert output.range_V[0] <= voltage.min()
    assert voltage.max() <= output.range_V[1]
    assert np.abs(np.diff(voltage[:, 1])).max() <= output.slew_V_per_ms * 1e3 / configuration.loop.rate_hz
    np.testing.assert_allclose(voltage[:, 1], excitation.samples, atol=0.05 * np.ptp(excitation.samples))

    series = recording(configuration, excitation, rows)
    assert (series.names, series.units) == (("voltage_V", "strain_um", "stage_um"), ("V", "um", "um"))
    kept = len(excitation.samples) - 2 * excitation.lead_cycles
    assert len(series) == -(-kept // 10)
    np.testing.assert_allclose(np.diff(series.time_s), 1e-3)
    low = output.range_V[0] + (0.05 if kind == "turns" else 0.22) * (output.range_V[1] - output.range_V[0])
    assert series.u.min() >= low - 1e-6, "the lead-in from the park voltage is cut away"

    file = tmp_path / "y.csv"
    write_csv(file, series)
    assert file.read_text().startswith("t_s,voltage_V,strain_um,stage_um\n")
    read = np.genfromtxt(file, delimiter=",", skip_header=1)
    np.testing.assert_allclose(read, np.column_stack([series.time_s, series.values]), rtol=1e-8, atol=1e-12)
    assert [path.name for path in tmp_path.iterdir()] == ["y.csv"]
