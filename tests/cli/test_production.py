"""From `commission` to TRACKING: what the report claims of the path error is what the running cell has."""

import json
from pathlib import Path

import numpy as np
import pytest

from micromanip.recordings import open_telemetry
from micromanip.rt.states import TRACKING
from tests.cells import SHARED

from .command import code_of

pytestmark = [pytest.mark.thorough, pytest.mark.live, pytest.mark.xdist_group("loop")]
"""Thorough: what is decided, and tried, is shown on a tuned cell by tests/design/commission/test_production.py."""

FACTORY = Path(__file__).parents[2] / "config" / "factory.yaml"
MARGIN = 2.0
"""The real loop may have so many times the path error of virtual time, in half of its seconds: this machine stalls."""


@pytest.fixture(scope="module")
def produced(tmp_path_factory):
    """Axis x alone, commissioned from factory values: the folder, and what was said."""
    folder = tmp_path_factory.mktemp("production")
    lines = FACTORY.read_text(encoding="utf-8").split("  y:\n    mode: strain")[0].splitlines()
    text = "\n".join(line for line in lines if not any(f"_{other}:" in line for other in "yz")) + "\n"
    text = text.replace("    seed: 1\n", "    seed: 1\n    axes: [x]\n")
    text = "\n".join(line for line in text.splitlines() if not line.strip().startswith(("variation:", "y: {", "z: {")))
    for old, new in SHARED[1:]:
        text = text.replace(old, new)
    config = folder / "cell.yaml"
    config.write_text(text.replace("cpu: 1 ", "cpu: null ") + "\n", encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        said = []
        patch.setattr("micromanip.cli.commission.emit_json", said.append)
        assert code_of("commission", config, "--axis", "x", "--out", folder / "out", "--json") == 0
    return folder, said[0]


def test_it_runs_as_it_was_tried(produced, capsys):
    folder, said = produced
    tuned = folder / "out" / "tuned.yaml"
    assert code_of("check", tuned, "--json") == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []
    armed = folder / "armed.yaml"
    armed.write_text(tuned.read_text(encoding="utf-8") + "arm_on_start: true\n", encoding="utf-8")
    recorded = folder / "run.mcap"
    command = ("run", armed, "--duration", "9", "--socket", folder / "control.sock", "--record", recorded, "--json")
    assert code_of(*command) == 0
    assert json.loads(capsys.readouterr().out)["state"] == "OFF"
    rows = np.concatenate(list(open_telemetry(recorded).rows()))
    rows = rows[rows["state"] == TRACKING]["axis"][10_000:, 0]
    claimed = said["production"]["path_error_um"]["x"]
    left, moved = (
        each[: len(each) // 10_000 * 10_000].reshape(-1, 10_000)
        for each in (rows["path_error_um"], rows["uncompensated_um"])
    )
    assert len(left) >= 4
    assert np.sqrt(np.mean(moved**2)) == pytest.approx(claimed["uncompensated_rms"], rel=0.4), "of another piece"
    second = np.median(np.sqrt(np.mean(left**2, axis=1)))
    assert second <= MARGIN * claimed["rms"]
    assert second >= 0.5 * claimed["rms"], "a path error that nobody disturbs is none that was tried"
