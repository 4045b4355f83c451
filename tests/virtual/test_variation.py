"""Cells with another plant, in virtual time."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from micromanip.errors import UsageError
from micromanip.settings.check import prepare
from micromanip.virtual.variation import VariedCell

CONFIG = Path(__file__).parents[2] / "config"
NOMINAL = {
    "stage_mass": 1.0,
    "stiffness": 1.0,
    "damping": 1.0,
    "delay_cycles": 0.0,
    "piezo_gain": 1.0,
    "hysteresis_gain": 1.0,
}


@pytest.fixture(scope="module")
def cell():
    return VariedCell(prepare(CONFIG / "simulated.yaml"), "x")


def test_only_the_plant_of_its_axis_changes(cell):
    options = cell.prepared.wiring.options["cell"]
    heavy = cell.varied({**NOMINAL, "stage_mass": 1.2, "delay_cycles": 0.5}, 1)
    driver = heavy.wiring.drivers["cell"]
    plant = driver.options.variation["x"]
    assert plant.stage_kg == pytest.approx(1.2 * options.plant.stage_kg)
    assert plant.amplifier_Hz < 900.0
    assert driver.options.variation["y"] == options.variation["y"]
    assert heavy.wiring.options["cell"] == driver.options
    assert cell.prepared.wiring.drivers["cell"].options.variation == options.variation, "the original is untouched"


def test_only_a_simulated_cell_can_be_varied():
    configuration = SimpleNamespace(
        outputs={"voltage_x": SimpleNamespace(driver="amp")}, drivers={"amp": SimpleNamespace(driver="c_card")}
    )
    with pytest.raises(UsageError, match="axis x is moved by c_card"):
        VariedCell(SimpleNamespace(configuration=configuration), "x").require_simulated()
