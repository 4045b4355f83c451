"""A swing about a held reference is told; noise, a moving reference and what the sensor's steps do are not."""

import numpy as np
import pytest

from micromanip.host.swing import Swings, swing
from micromanip.rt.states import CLOSED
from micromanip.rt.telemetry import ROW

RNG = np.random.default_rng(1)


def rows(stage_um, reference_um=0.0, period_ns=100_000):
    made = np.zeros(len(stage_um), ROW)
    made["time_ns"], made["phase"] = period_ns * np.arange(len(made)), CLOSED
    made["axis"]["stage_um"][:, 0], made["axis"]["reference_um"][:, 0] = stage_um, reference_um
    return made


def seen(stage_um, reference_um=0.0, period_ns=100_000):
    """In parts, as the host reads them."""
    swings = Swings(1)
    for part in np.array_split(rows(stage_um, reference_um, period_ns), 7):
        swings.add(part)
    return swings.of(0, of_path=True, way_um=126.0)


def sine(hertz, um, rate_hz=10_000, seconds=2.0):
    return um * np.sin(2 * np.pi * hertz * np.arange(round(seconds * rate_hz)) / rate_hz)


@pytest.mark.parametrize(("hertz", "um"), [(4.3, 2.0), (42.0, 10.0), (650.0, 0.8)])
def test_a_swing_is_told_with_frequency_and_amplitude(hertz, um):
    found = seen(sine(hertz, um) + RNG.normal(0.0, 0.1 * um, 20_000))
    assert found["Hz"] == pytest.approx(hertz, abs=1.0)
    assert found["um"] == pytest.approx(um, rel=0.05)


@pytest.mark.parametrize("sample_every", [10, 40])
def test_a_sensor_of_a_slow_bus_is_read_where_it_is_new(sample_every):
    y = sine(42.0, 2.0)
    found = seen(y[np.arange(len(y)) // sample_every * sample_every])
    assert found["Hz"] == pytest.approx(42.0, abs=1.0)
    assert found["um"] == pytest.approx(2.0, rel=0.1)


def test_what_is_no_swing():
    y = sine(42.0, 10.0)
    assert seen(RNG.normal(0.0, 3.0, 20_000)) is None
    assert seen(np.cumsum(RNG.normal(0.0, 0.05, 20_000))) is None, "a drift"
    assert seen(sine(42.0, 0.1)) is None, "too little"
    assert seen(y, reference_um=y) is None, "it follows its reference"
    assert seen(y[:5000]) is None, "half a second"
    assert seen(np.full(20_000, np.nan)) is None
    opened = rows(y)
    opened["phase"][-1] = CLOSED - 1
    swings = Swings(1)
    swings.add(opened)
    assert swings.of(0, of_path=True, way_um=126.0) is None, "its loop was open meanwhile"
    assert swing(opened["time_ns"], y, 20.0) is None
