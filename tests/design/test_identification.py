"""Excitations stay inside the output's limits, begin and end softly, and only the chosen axis moves."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micromanip.design.excitation import (
    IDENTIFICATION_HZ,
    IDENTIFICATION_SHARE,
    band_noise,
    multisine,
    shrinking_triangle,
    soft,
)
from micromanip.design.identification import design, recording, samples_for, variant, write_csv
from micromanip.rt.states import TRACKING
from micromanip.settings.check import prepare
from micromanip.sim.experiment import VirtualExperiment

FACTORY = Path(__file__).parents[2] / "config" / "factory.yaml"
KINDS = ("multisine", "triangle", "step")


@pytest.fixture(scope="module")
def prepared():
    return prepare(FACTORY)


def with_output(prepared, **updates):
    """The configuration with another output of axis x."""
    configuration = prepared.configuration
    output = configuration.outputs["voltage_x"].model_copy(update=updates)
    return configuration.model_copy(update={"outputs": configuration.outputs | {"voltage_x": output}})


@settings(max_examples=30)
@given(
    low=st.floats(-100.0, 100.0),
    span=st.floats(0.1, 200.0),
    slew=st.floats(1.0, 1e5),
    rate=st.sampled_from([200.0, 1000.0, 10_000.0]),
    seed=st.integers(0, 1000),
)
def test_multisine_stays_inside_range_and_slew(low, span, slew, rate, seed):
    wave = multisine(low, low + span, slew, rate, 2.0, seed)
    assert len(wave) == round(2.0 * rate)
    assert wave.min() >= low - 1e-9 * span
    assert wave.max() <= low + span + 1e-9 * span
    assert np.abs(np.diff(wave)).max() * rate <= 0.5 * slew * 1.01  # half the limit, between two samples a little more
    fills = np.ptp(wave) >= 0.999 * span
    at_half_slew = np.abs(np.diff(wave)).max() * rate >= 0.45 * slew
    assert fills or at_half_slew, "neither limit is used"


@pytest.mark.parametrize("seed", range(5))
def test_the_multisine_covers_its_range_better_than_with_zero_phases(seed):
    def crest(wave):
        return np.ptp(wave) / 2 / wave.std()

    t = np.arange(40_000) / 1000.0
    zero = sum(a * np.cos(2 * np.pi * f * t) for f, a in zip(IDENTIFICATION_HZ, IDENTIFICATION_SHARE, strict=True))
    assert crest(multisine(0.0, 100.0, 1e6, 1000.0, 13.0, seed)) < 0.95 * crest(zero)


def test_the_multisine_has_its_frequencies_only():
    wave = multisine(0.0, 100.0, 1e6, 1000.0, 10.0, 1)
    power = np.abs(np.fft.rfft(wave - wave.mean())) ** 2
    asked = np.round(np.array(IDENTIFICATION_HZ) * 10).astype(int)
    assert power[asked].sum() > 0.999 * power.sum()


def test_the_seed_is_the_experiment():
    one, two, three = (multisine(0.0, 100.0, 1e6, 1000.0, 5.0, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, two)
    assert np.abs(one - three).max() > 1.0


@given(low=st.floats(-50, 50), span=st.floats(1.0, 100.0), turns=st.integers(2, 8), count=st.integers(20, 200))
def test_the_triangle_shrinks_evenly(low, span, turns, count):
    wave = shrinking_triangle(low, low + span, turns, count)
    assert wave[0] == low
    assert wave.min() >= low - 1e-9
    assert wave.max() <= low + span + 1e-9
    corners = wave[::count]
    swings = np.abs(np.diff(corners))
    assert swings[0] == pytest.approx(span)
    assert (np.diff(swings[1:]) < 0).all()
    np.testing.assert_allclose(np.diff(corners[1::2]), -span / 2 / turns, atol=1e-9)
    np.testing.assert_allclose(np.diff(corners[2::2]), span / 2 / turns, atol=1e-9)


def test_noise_is_seeded_and_has_its_size():
    one, two = (band_noise(1.5, 100.0, 1e4, 20_000, seed=3) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert one.std() == pytest.approx(1.5)


@given(st.floats(-20, 150), st.floats(-20, 150), st.floats(-20, 150), st.floats(10.0, 1e5))
def test_lead_in_and_lead_out_are_soft(rest, first, last, slew):
    wave = np.linspace(first, last, 50)
    whole = soft(wave, rest, 1000.0, slew)
    lead = (len(whole) - len(wave)) // 2
    np.testing.assert_array_equal(whole[lead:-lead], wave)
    assert whole[0] == pytest.approx(rest)
    assert whole[-1] == pytest.approx(rest)
    for ramp in (np.append(whole[:lead], wave[0]), np.append(wave[-1], whole[-lead:])):
        speed = np.abs(np.diff(ramp)) * 1000.0
        assert speed.max() <= 0.5 * slew * 1.01 + 1e-9
        assert max(speed[0], speed[-1]) <= 0.01 * speed.max() + 1e-9


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "limits",
    [{}, {"capacitance_uF": 10.0, "current_mA": 6.0}, {"slew_V_per_ms": 0.3}, {"range_V": (0.0, 60.0), "park_V": 10.0}],
    ids=["factory", "amplifier", "slew", "range"],
)
def test_excitations_respect_the_output(prepared, kind, limits):
    configuration = with_output(prepared, **limits)
    output, rate = configuration.outputs["voltage_x"], configuration.loop.rate_hz
    whole = design(configuration, "x", kind, 3.0, seed=1).samples
    assert whole.min() >= output.range_V[0]
    assert whole.max() <= output.range_V[1]
    assert whole[0] == pytest.approx(output.park_V)
    assert whole[-1] == pytest.approx(output.park_V)
    assert np.abs(np.diff(whole)).max() * rate <= output.fastest_V_per_s
    if "current_mA" in limits:
        assert output.fastest_V_per_s == 600.0  # 6 mA into 10 uF


def test_the_triangle_takes_its_time_with_a_slow_output(prepared):
    quick, slow = (design(with_output(prepared, slew_V_per_ms=slew), "x", "triangle", 5.0, 1) for slew in (40.0, 0.2))
    assert len(slow.samples) > 1.5 * len(quick.samples)


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
    rows = VirtualExperiment(prepared)(variant(configuration), duration_s, samples_for(configuration, excitation))
    assert (rows["state"] == TRACKING).all()
    assert (rows["fault"] == 0).all()
    voltage = rows["axis"]["voltage_V"]
    assert np.abs(voltage[:, [0, 2]]).max() <= 1e-6, "the other axes stay parked"
    output = configuration.outputs["voltage_y"]
    assert output.range_V[0] <= voltage.min()
    assert voltage.max() <= output.range_V[1]
    assert np.abs(np.diff(voltage[:, 1])).max() <= output.slew_V_per_ms * 1e3 / configuration.loop.rate_hz
    np.testing.assert_allclose(voltage[:, 1], excitation.samples, atol=0.05 * np.ptp(excitation.samples))

    columns = recording(configuration, excitation, rows)
    assert list(columns) == ["t_s", "voltage_V", "strain_um", "stage_um"]
    kept = len(excitation.samples) - 2 * excitation.lead_cycles
    assert len(columns["t_s"]) == -(-kept // 10)
    np.testing.assert_allclose(np.diff(columns["t_s"]), 1e-3)
    low = output.range_V[0] + 0.22 * (output.range_V[1] - output.range_V[0])
    assert columns["voltage_V"].min() >= low - 1e-6, "the lead-in from the park voltage is cut away"

    file = tmp_path / "y.csv"
    write_csv(file, columns)
    assert file.read_text().startswith("t_s,voltage_V,strain_um,stage_um\n")
    read = np.genfromtxt(file, delimiter=",", skip_header=1)
    np.testing.assert_allclose(read, np.column_stack(list(columns.values())), rtol=1e-8, atol=1e-12)
    assert [path.name for path in tmp_path.iterdir()] == ["y.csv"]


def test_the_same_seed_gives_the_same_recording(prepared):
    configuration = prepared.configuration
    excitation = design(configuration, "x", "multisine", 1.0, 1)
    duration_s = len(excitation.samples) / configuration.loop.rate_hz
    one, two = (
        VirtualExperiment(prepared)(variant(configuration), duration_s, samples_for(configuration, excitation))
        for _ in range(2)
    )
    np.testing.assert_array_equal(one["axis"]["strain_um"], two["axis"]["strain_um"])


def test_a_signal_without_samples_is_no_column(prepared):
    configuration = prepared.configuration
    excitation = design(configuration, "x", "multisine", 1.0, 1)
    duration_s = len(excitation.samples) / configuration.loop.rate_hz
    rows = VirtualExperiment(prepared)(variant(configuration), duration_s, samples_for(configuration, excitation))
    rows["axis"]["stage_um"][:, 0] = np.nan
    assert list(recording(configuration, excitation, rows)) == ["t_s", "voltage_V", "strain_um"]
