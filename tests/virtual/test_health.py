"""What `analyse health` says of the simulated cell: a plant that changes."""

import re

import pytest
import yaml

from campaigns.report import CONFIG
from micromanip.design.analyse.health import checked, closed_loops
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

from .injected import measure_virtually

SIMULATED = CONFIG / "simulated.yaml"


def health(config):
    """Of axis x."""
    prepared = prepare(config)
    configuration = prepared.configuration
    path = VirtualExperiment(prepared).path(configuration, "x")
    loops = closed_loops(configuration.axes["x"], "x")
    return checked(configuration, path, "x", {loop: measure_virtually(prepared, "x", loop, 0.3) for loop in loops})


def heavier(folder, kg):
    """The simulated cell with another mass on the stage of axis x."""
    document = yaml.safe_load(SIMULATED.read_text())
    simulated = next(each for each in document["drivers"].values() if each["driver"] == "simulated")
    simulated.setdefault("variation", {})["x"] = {"stage_kg": kg}
    file = folder / "heavier.yaml"
    file.write_text(yaml.safe_dump(document))
    return file


@pytest.mark.long
def test_a_spindle_that_is_exchanged_is_seen(tmp_path):
    """Half as heavy again, its mode is 18 % lower: outside of what the margins were judged for, told by name."""
    found = health(SIMULATED)
    assert found.problems == ()
    assert found.figures.mode_Hz == pytest.approx(found.tuned.mode_Hz, rel=0.02)
    (first, *_) = health(heavier(tmp_path, 18.0)).problems
    assert re.match(r"mode_Hz is 5\d.*, 6\d.* in the model: robustness was judged within", first)
