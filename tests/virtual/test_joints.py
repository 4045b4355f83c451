"""Joints that swing at another frequency than is said, in the whole cell: found, and told in the rows."""

import re
from pathlib import Path

import numpy as np
import pytest

from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

CONFIG = Path(__file__).parents[2] / "config" / "simulated.yaml"
SAID = "  oscillation_Hz: 8       # the robot's joints\n"


@pytest.mark.parametrize("range_percent", [0.0, 50.0])
def test_where_the_joints_swing_stands_in_the_rows(tmp_path, range_percent):
    text = CONFIG.read_text(encoding="utf-8")
    assert text.count(SAID) == 1
    text, sections = re.subn(r"\n  axes:\n(?:    .*\n)+", "\n", text)
    assert sections == 1, "what was fitted of each axis"
    file = tmp_path / "cell.yaml"
    said = f"  oscillation_Hz: 9.5\n  oscillation_um_per_s: 5\n  oscillation_range_percent: {range_percent}\n"
    file.write_text(text.replace(SAID, said), encoding="utf-8")
    prepared = prepare(file)
    cell = VirtualExperiment(prepared, process=True).cell(prepared.configuration)
    cell.arm(every=1000)
    axis = cell.run(3.0, every=100)["axis"][:, :3]
    if range_percent == 0.0:
        assert np.isnan(axis["joint_1_Hz"]).all()
    else:
        true_Hz = np.tile([8.0, 0.97 * 8.0, 1.03 * 8.0], (50, 1))
        assert axis["joint_1_Hz"][-50:] == pytest.approx(true_Hz, abs=0.1)
    assert np.isnan(axis["joint_2_Hz"]).all(), "there is one"
    assert np.isnan(axis["joint_3_Hz"]).all()
