"""Bad plants and cables on the simulated cell: stopped before harm, with what was seen and what to do."""

import re
from pathlib import Path

import numpy as np
import pytest

from micromanip.design.commission.axis import Watched, commission_axis
from micromanip.errors import CheckFailed
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

pytestmark = pytest.mark.long

FACTORY = (Path(__file__).parents[2] / "config" / "factory.yaml").read_text(encoding="utf-8")
STRAIN = "  strain_{0}: {{driver: cell, max_age_us: 300}}\n"


class Recorded:
    """An experiment that remembers in which modes the cell was run; `change` tampers with the rows."""

    def __init__(self, prepared, change=lambda rows: rows):
        self.experiment, self.change, self.modes = VirtualExperiment(prepared), change, []

    def __call__(self, configuration, seconds, samples=None, every=1):
        self.modes.append(configuration.axes["x"].mode)
        return self.change(self.experiment(configuration, seconds, samples, every))


def cell(tmp_path, *changes):
    text = FACTORY
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "cell.yaml"
    file.write_text(text, encoding="utf-8")
    return prepare(file)


def refusal(prepared, change=lambda rows: rows):
    """What commissioning says, and that it never left open loop."""
    recorded = Recorded(prepared, change)
    with pytest.raises(CheckFailed) as refused:
        commission_axis(prepared.configuration, Watched(recorded), "x", lambda _: None)
    assert set(recorded.modes) == {"voltage"}, "a loop was closed"
    return str(refused.value)


def plant(figures):
    return "    variation: ", f"    plant: {{{figures}}}\n    variation: "


def test_gauges_on_the_wrong_axes(tmp_path):
    x, y = STRAIN.format("x"), STRAIN.format("y")
    crossed = cell(
        tmp_path,
        (x, x.replace("cell,", "cell, channel: strain_y,")),
        (y, y.replace("cell,", "cell, channel: strain_x,")),
    )
    assert "the gauges or the outputs are swapped" in refusal(crossed)


def test_a_gauge_with_its_sign_reversed(tmp_path):
    def reverse(rows):
        rows["axis"]["strain_um"][:, 0] *= -1.0
        return rows

    assert "the wrong way, feedback would run away" in refusal(cell(tmp_path), reverse)


def test_a_dead_actuator(tmp_path):
    dead = cell(tmp_path, plant("amplifier_range_V: [-0.001, 0.001]"))
    assert "the actuator does not move" in refusal(dead)


def test_an_amplifier_that_saturates(tmp_path):
    said = refusal(cell(tmp_path, plant("amplifier_range_V: [-20.0, 90.0]")))
    assert re.search(r"near \d+ V the gauge follows the voltage with -?\d+ % of its usual slope", said)


def test_an_actuator_with_little_stroke(tmp_path):
    weak = cell(tmp_path, plant("reversible_um: [0.2, 0.0, 0.0]"))
    assert re.search(r"the record reaches .* % of the set-point's range", refusal(weak))


def test_a_gauge_that_is_clipped(tmp_path):
    def clip(rows):
        rows["axis"]["strain_um"][:, 0] = np.minimum(rows["axis"]["strain_um"][:, 0], 70.0)
        return rows

    assert "the sensor is clipped" in refusal(cell(tmp_path), clip)


def test_a_fault_on_the_way_ends_it(tmp_path):
    def fault(rows):
        rows["fault"][-10:] = 4
        return rows

    said = refusal(cell(tmp_path), fault)
    assert "the experiment was ended by fault X-201; nothing was tuned. Likely: " in said
    assert said.startswith("axis x: polarity and scale: ")


def test_a_resonance_that_has_moved_is_followed(tmp_path):
    """Half as much mass again on the stage: another mode, another outer loop, the same margins."""
    heavy = cell(tmp_path, plant("stage_kg: 18.0"))
    found = commission_axis(heavy.configuration, Watched(VirtualExperiment(heavy)), "x", lambda _: None)
    poles = found.stage.found.modes.poles
    swinging = np.log(poles[poles.imag > 1e-9]) / found.stage.found.dt  # a real pole, of the delays, is no resonance
    mode_Hz = np.abs(swinging[np.argmin(-swinging.real / np.abs(swinging))]) / (2 * np.pi)
    assert mode_Hz == pytest.approx(66.9 * np.sqrt(12.0 / 18.0), rel=0.03)
    assert found.outer.margins.gain_dB >= 6.0
    assert found.outer.margins.phase_deg >= 35.0
