"""A spindle that turns at another speed than was said, in virtual time, with the truth of the simulation."""

import re
from pathlib import Path

import numpy as np
import pytest

from micromanip.rt.states import NO_FAULT, TOOTH_LOST, TRACKING
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

CONFIG = Path(__file__).parents[2] / "config" / "simulated.yaml"
FORCE = "force: {start_s: 5.0, static_N: 80.0, tooth_N: 40.0, tooth_Hz: 200.0, noise_N: 5.0}"
ENTERED_S, CYCLES = 4.0, 35_000


def tracked(tmp_path, range_percent, tooth_Hz):
    """Rms (um) of the axes' path errors in the last second of a cut, the telemetry of all of it, and the cell."""
    text = CONFIG.read_text(encoding="utf-8")
    assert text.count(FORCE) == 1
    text = text.replace(FORCE, f"force: {{start_s: {ENTERED_S}, tooth_Hz: {tooth_Hz}}}")
    text, axes = re.subn("oscillation_range_percent: .*", f"oscillation_range_percent: {range_percent}", text)
    assert axes == 3
    file = tmp_path / "cell.yaml"
    file.write_text(text, encoding="utf-8")
    prepared = prepare(file)
    cell = VirtualExperiment(prepared, process=True).cell(prepared.configuration)
    cell.arm(every=1000)
    cell.run(ENTERED_S - float(cell.state[0]["cycle"]) * 1e-4, every=1000)
    rows = cell.run(1e-4 * CYCLES)["axis"]
    assert (cell.state[0]["state"], cell.state[0]["fault"]) == (TRACKING, NO_FAULT)
    return np.sqrt(np.mean(rows["path_error_um"][-10_000:, :3] ** 2, axis=0)), rows, cell


def told(cell):
    return [(int(e["code"]), int(e["axis"]), float(e["value"]), float(e["limit"])) for e in cell.state[0]["event"]]


def test_the_speed_is_found_and_costs_nothing_any_more(tmp_path):
    exact, _, _ = tracked(tmp_path, 0.0, 200.0)
    fixed, fixed_rows, _ = tracked(tmp_path, 0.0, 204.0)
    followed, rows, cell = tracked(tmp_path, 3.0, 204.0)
    assert (fixed > 2.5 * exact).all()
    assert followed == pytest.approx(exact, rel=0.05)
    assert rows["tooth_Hz"][-1] == pytest.approx(204.0, abs=0.1)
    assert np.isnan(fixed_rows["tooth_Hz"]).all()
    assert TOOTH_LOST not in [code for code, *_ in told(cell)]
