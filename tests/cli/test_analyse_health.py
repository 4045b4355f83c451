"""``analyse health`` on the simulated cell: checks that add up to a history, a plant that changes, bad input."""

import json
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from micromanip.cli.main import cli

CONFIG = Path(__file__).parents[2] / "config" / "simulated.yaml"


def drift(*arguments):
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
    """A fifth heavier, its mode is 9 % lower: told by its second check beside five before, by name."""
    history = tmp_path / "drift.csv"
    for seed in range(1, 6):
        done = drift(CONFIG, "--axis", "x", "--history", history, "--seed", seed, "--false-alarms", 100, "--json")
        assert json.loads(done.stdout)["problems"] == []
        assert done.exit_code == 0
    document = json.loads(done.stdout)["axes"][0]
    mode = document["figures"][1]
    assert mode["commissioned"] == pytest.approx(mode["latest"], rel=0.02)
    for seed in (9, 10):
        done = drift(
            heavier(tmp_path, 14.4), "--axis", "x", "--history", history, "--seed", seed, "--false-alarms", 100,
            "--out", tmp_path / "out",
        )  # fmt: skip
    assert done.exit_code == 1
    assert "mode_Hz drifts since" in done.exception.args[0]
    assert len(history.read_text().splitlines()) == 8
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"drift_x.svg"}


def test_bad_input_changes_nothing(tmp_path):
    foreign = tmp_path / "foreign.csv"
    foreign.write_text("a;b\n1;2\n")
    done = drift(CONFIG, "--axis", "x", "--history", foreign)
    assert done.exit_code == 1
    assert "foreign.csv:1: no history of `micromanip analyse health`" in str(done.exception)
    assert foreign.read_text() == "a;b\n1;2\n"
    assert "there is no axis 'w'" in str(drift(CONFIG, "--axis", "w").exception)
    assert "is not a simulated cell" in str(drift(CONFIG.with_name("can.yaml"), "--axis", "x").exception)
