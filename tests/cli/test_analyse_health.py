"""``analyse health`` on the simulated cell: a plant that changes, bad input."""

import json
import re
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from micromanip.cli.main import cli

CONFIG = Path(__file__).parents[2] / "config" / "simulated.yaml"


def health(*arguments):
    return CliRunner().invoke(cli, ["analyse", "health", *map(str, arguments)])


def heavier(folder, kg):
    """The simulated cell with another mass on the stage of axis x."""
    document = yaml.safe_load(CONFIG.read_text())
    simulated = next(each for each in document["drivers"].values() if each["driver"] == "simulated")
    simulated.setdefault("variation", {})["x"] = {"stage_kg": kg}
    file = folder / "heavier.yaml"
    file.write_text(yaml.safe_dump(document))
    return file


@pytest.mark.long
def test_a_spindle_that_is_exchanged_is_seen(tmp_path):
    """Half as heavy again, its mode is 18 % lower: outside of what the margins were judged for, told by name."""
    done = health(CONFIG, "--axis", "x", "--json")
    document = json.loads(done.stdout)
    assert (done.exit_code, document["problems"]) == (0, [])
    mode = document["axes"][0]["figures"][1]
    assert mode["latest"] == pytest.approx(mode["commissioned"], rel=0.02)
    done = health(heavier(tmp_path, 18.0), "--axis", "x")
    assert done.exit_code == 1
    assert re.search(r"axis x: mode_Hz is 5\d.*, 6\d.* in the model: robustness was judged within", str(done.exception))


def test_bad_input_is_told():
    assert "there is no axis 'w'" in str(health(CONFIG, "--axis", "w").exception)
    assert "is not a simulated cell" in str(health(CONFIG.with_name("can.yaml"), "--axis", "x").exception)
