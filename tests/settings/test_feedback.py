"""What the buses leave of the feedback: margins, delays, and what `check` says of them."""

import math

import numpy as np
import pytest
import yaml

from campaigns.report import CONFIG
from micromanip.errors import ConfigError
from micromanip.settings.check import prepare
from micromanip.settings.checks.feedback import (
    LEAST_DEG,
    RESERVE_DEG,
    feedback_warnings,
    fitting_gain,
    mean_slope,
    strain_loop,
)
from micromanip.settings.wiring.timing import output_cycles, output_timing, signal_timing

PAPER = CONFIG / "paper.yaml"
BUS = {"input_rate_Hz": 1000.0, "input_latency_us": 0.0, "output_rate_Hz": 1000.0, "output_latency_us": 0.0}


def document(bus=None, **inner):
    """The tuned cell in mode strain, behind a bus, with ages that it allows, and other gains."""
    made = yaml.safe_load(PAPER.read_text(encoding="utf-8"))
    made["drivers"]["cell"]["bus"] = bus
    made["reference"] = {"source": "hold", "offset_um": 60.0}
    for axis in made["axes"].values():
        axis["mode"] = "strain"
        axis["inner"].update(inner)
    for signal in made["signals"].values():
        signal["max_age_us"] = None
    return made


def prepared(tmp_path, made):
    file = tmp_path / "cell.yaml"
    file.write_text(yaml.safe_dump(made, sort_keys=False), encoding="utf-8")
    return prepare(file)


def loop_of(tmp_path, bus=None, **inner):
    cell = prepared(tmp_path, document(bus, **inner))
    return strain_loop(cell.configuration, cell.wiring, "x")


def test_the_mean_slope_is_that_of_the_models_major_loop(tmp_path):
    """The plant makes 143 um of -20 to 140 V."""
    cell = prepared(tmp_path, document())
    assert mean_slope(cell.configuration, "x") == pytest.approx(135.0 / 160.0, rel=0.06)


def test_integral_action_behind_a_delay_has_the_margin_of_the_textbook(tmp_path):
    """Crossover at slope K/Ti, 90 deg less crossover times delay; it swings where the delay takes a quarter turn."""
    gains = {"K_V_per_um": 1e-4, "Ti_ms": 1e-3, "Td_ms": 0.0}
    loop = loop_of(tmp_path, {**BUS, "input_latency_us": 300.0, "output_latency_us": 500.0}, **gains)
    omega = 0.1 * mean_slope(prepared(tmp_path, document()).configuration, "x") * 1e3
    # both ways, two cycles of the loop, at worst a whole period until the next write; the half sample for which an
    # output is held is what the sum over samples is ahead of an integral
    delay_s = 0.3e-3 + 0.5e-3 + 0.2e-3 + 1e-3
    assert loop.crossover_Hz == pytest.approx(omega / (2 * math.pi), rel=0.02)
    assert loop.phase_deg == pytest.approx(90.0 - math.degrees(omega * delay_s), abs=1.5)
    assert loop.swing_Hz == pytest.approx(0.25 / delay_s, rel=0.05)


def test_a_loop_that_its_bus_can_not_carry_is_refused_with_the_gain_that_fits(tmp_path):
    with pytest.raises(ConfigError) as refused:
        prepared(tmp_path, document(BUS))
    first = str(refused.value).splitlines()[0]
    assert "axes.x.inner.K_V_per_um: the strain loop would have" in first
    assert "its slowest path is strain_x 1000 Hz + voltage_x 1000 Hz, 2.2 ms" in first
    gain = float(first.split("Td_ms ")[1].split(" would fit")[0])
    assert prepared(tmp_path, document(BUS, K_V_per_um=gain))
    with pytest.raises(ConfigError):
        prepared(tmp_path, document(BUS, K_V_per_um=1.5 * gain))


def test_a_loop_between_limit_and_reserve_is_told_of(tmp_path):
    def cell(gain):
        return prepared(tmp_path, document(BUS, K_V_per_um=gain))

    low, high = 0.02, 0.6
    slow = cell(low)

    def phase_deg(gain):
        """That of the loop as it would be with another gain, refused or not."""
        inner = slow.configuration.axes["x"].inner.model_copy(update={"K_V_per_um": gain})
        return strain_loop(slow.configuration, slow.wiring, "x", inner).phase_deg

    assert phase_deg(low) > RESERVE_DEG > LEAST_DEG > phase_deg(high)
    for _ in range(20):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if phase_deg(middle) > 25.0 else (low, middle)
    between = cell(low)
    told = dict(feedback_warnings(between.configuration, between.wiring))
    assert told["axes", "x", "inner"].startswith("the strain loop has only 25 deg")
    fits = fitting_gain(between.configuration, between.wiring, "x")
    assert 0.02 < fits < low
    assert ("axes", "x", "inner") not in dict(feedback_warnings(cell(fits).configuration, between.wiring))


def test_a_swing_below_the_watched_band_is_told_of(tmp_path):
    slow = prepared(tmp_path, document({**BUS, "output_latency_us": 1000.0}, K_V_per_um=0.02))
    told = [text for key, text in feedback_warnings(slow.configuration, slow.wiring) if key[-1] == "band_Hz"]
    assert len(told) == 3
    band = told[0].split("; ")[1].split(" sees")[0]
    made = document({**BUS, "output_latency_us": 1000.0}, K_V_per_um=0.02)
    made["faults"] = {"axis": {"oscillation": {"band_Hz": yaml.safe_load(band)}}}
    seen = prepared(tmp_path, made)
    assert not [text for key, text in feedback_warnings(seen.configuration, seen.wiring) if key[-1] == "band_Hz"]


def test_a_notch_counts_in_the_phase_and_needs_samples_that_show_it(tmp_path):
    """Below its centre it lags: at crossover by the angle of 1 - d k x / (1 - x^2 + k x), x = i frequency/centre."""
    plain = loop_of(tmp_path, BUS, K_V_per_um=0.02)
    centre_Hz, width_Hz = 3.0 * plain.crossover_Hz, plain.crossover_Hz
    notch = {"frequency_Hz": centre_Hz, "width_Hz": width_Hz, "depth_percent": 90.0}
    loop = loop_of(tmp_path, BUS, K_V_per_um=0.02, notch=notch)
    x, k = 1j * loop.crossover_Hz / centre_Hz, width_Hz / centre_Hz
    lag_deg = math.degrees(np.angle(1.0 - 0.9 * k * x / (1.0 + x * x + k * x)))
    assert lag_deg < -4.0
    assert loop.phase_deg - plain.phase_deg == pytest.approx(lag_deg, abs=1.5)
    for mode in ("strain", "voltage"):
        made = document(BUS, K_V_per_um=0.02, notch=notch | {"frequency_Hz": 460.0})
        made["axes"]["x"]["mode"] = mode
        with pytest.raises(ConfigError) as refused:
            prepared(tmp_path, made)
        says = "axes.x.inner: a notch at 460 Hz needs at least 1022 samples per second, not 1000 (strain_x 1000 Hz)"
        assert says in str(refused.value)


def test_samples_that_are_stale_by_design(tmp_path):
    made = document({**BUS, "input_latency_us": 400.0}, K_V_per_um=0.02)
    made["signals"]["strain_y"]["max_age_us"] = 1399.0
    with pytest.raises(ConfigError) as refused:
        prepared(tmp_path, made)
    says = r"signals.strain_y.max_age_us: stale by design: a sample is up to 1400 us old"
    assert says in str(refused.value)
    assert "(1000 Hz, latency 400 us); 3400 would allow for two lost ones" in str(refused.value)
    made["signals"]["strain_y"]["max_age_us"] = 1400.0
    assert prepared(tmp_path, made)


@pytest.mark.parametrize(
    ("bus", "key", "says"),
    [
        (
            {"input_rate_Hz": 2000.0, "output_rate_Hz": 10_000.0},
            "sample_cycles",
            "1 does not go with stage_x 2000 Hz: at 10000 cycles a second a sample comes every 5; write 5",
        ),
        (
            {"input_rate_Hz": 10_000.0, "output_rate_Hz": 10_000.0, "output_latency_us": 350.0},
            "model.delay_cycles",
            "2 leaves out the way of voltage_x, 350 us: at least 3",
        ),
    ],
)
def test_an_outer_loop_for_another_bus(tmp_path, bus, key, says):
    made = document(bus, K_V_per_um=0.1)
    for axis in made["axes"].values():
        axis["mode"] = "stage"
    made["reference"]["offset_um"] = 0.0
    with pytest.raises(ConfigError) as refused:
        prepared(tmp_path, made)
    assert f"axes.x.outer.{key}: {says}" in str(refused.value)


def test_what_the_loop_gets_of_rates_and_ways(tmp_path):
    cell = prepared(tmp_path, document({**BUS, "input_rate_Hz": 2000.0, "output_latency_us": 300.0}, K_V_per_um=0.02))
    assert signal_timing(cell.configuration, cell.wiring, "strain_x").rate_hz == 2000.0
    assert signal_timing(cell.configuration, cell.wiring, "true_strain_x").rate_hz == 10_000.0
    assert output_cycles(cell.configuration, output_timing(cell.configuration, cell.wiring, "voltage_x")) == 8
    assert set(cell.parameters[0]["axis"]["answer_cycles"]) == {8}
    plain = prepare(PAPER)
    assert not plain.parameters[0]["axis"]["answer_cycles"].any()
