"""The plant in real time is the cyclic driver: same calls, same bits."""

import json

import numpy as np
import pytest
from drivers.simulated_bench import PERIOD_NS, Bench
from micromanip_drivers.simulated.driver import SimulatedCell
from micromanip_drivers.simulated.options import Options

from micromanip.emulation.plant import MOST_PERIODS, PlantInRealTime

OPTIONS = {"seed": 7, "axes": ["x", "y"], "lines": {}}
BEGIN_NS = 5_000_000_123


@pytest.fixture
def plant():
    driver = SimulatedCell(Options.model_validate_json(json.dumps(OPTIONS)), PERIOD_NS)
    plant = PlantInRealTime(driver)
    plant.begin(BEGIN_NS)
    return plant


def cyclic():
    bench = Bench(OPTIONS)
    bench.now_ns = BEGIN_NS
    return bench


@pytest.mark.compiled_only
@pytest.mark.parametrize("periods", [1, 5])
def test_regular_events_are_the_cyclic_driver_bit_for_bit(plant, periods):
    bench = cyclic()
    volts = np.random.default_rng(3)
    for k in range(400):
        commands = [*volts.uniform(-20, 150, 2), 1.0, 0.0, float(k % 2)]
        for name, value in zip(bench.driver.outputs, commands, strict=True):
            plant.write(name, value)
        plant.advance_to(BEGIN_NS + (k + 1) * periods * PERIOD_NS)
        assert bench.exchange(*commands, periods=periods) == 0
        for i, name in enumerate(bench.driver.inputs):
            signal = bench.signals[i]
            assert plant.read(name) == (signal["value"], signal["time_ns"]), (k, name)


def test_a_command_is_in_force_from_its_instant_on(plant):
    """Not from the next event on: the stage has moved by then."""
    at_rest = plant_strain(plant, 20)
    plant.write("amplifier_enable", 1.0)
    plant.write("voltage_x", 50.0)
    plant.advance_to(plant.time_ns)
    plant.advance_to(plant.time_ns + 20 * PERIOD_NS)
    assert plant.value("true_strain_x") > at_rest + 10.0


def plant_strain(plant, periods):
    plant.advance_to(plant.time_ns + periods * PERIOD_NS)
    return plant.value("true_strain_x")


def test_a_long_stall_is_counted_and_not_made_up(plant):
    bench = cyclic()
    plant.advance_to(BEGIN_NS + PERIOD_NS)
    plant.advance_to(BEGIN_NS + 10_001 * PERIOD_NS)
    assert plant.stalls.count == 1
    assert plant.stalls.longest_ms == pytest.approx(1000.0)
    assert plant.time_ns == BEGIN_NS + 10_001 * PERIOD_NS, "samples carry the clock's time all the same"
    assert bench.exchange() == 0
    assert bench.exchange(periods=MOST_PERIODS) == 0
    assert plant.value("deviation_x") == bench.signal("deviation")["value"], "the rest of the time stood still"
