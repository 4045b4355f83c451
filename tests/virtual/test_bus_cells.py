"""Cells behind a bus, in virtual time: tuned ones hold the path, and `commission` tunes them."""

import numpy as np
import pytest
import yaml

from campaigns.report import CONFIG
from micromanip.rt.states import NO_FAULT, TRACKING
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell

pytestmark = pytest.mark.compiled_only


def tracked(prepared, seconds=7.0):
    """Path error with and without compensation, rms um an axis, and the cell, after so many seconds."""
    cell = VirtualCell(prepared.parameters, prepared.wiring, prepared.samples)
    cell.arm()
    rows = cell.run(seconds)
    a = cell.state[0]["figures"]
    return np.sqrt(a["error_squares"] / a["errors"]), np.sqrt(a["uncompensated_squares"] / a["errors"]), cell, rows


@pytest.mark.parametrize(("name", "share"), [("simulated_2khz", 0.035), ("simulated_1khz", 0.05)])
def test_a_cell_behind_a_bus_holds_the_path(name, share):
    error, uncompensated, cell, rows = tracked(prepare(CONFIG / f"{name}.yaml"))
    assert (cell.state[0]["state"], cell.state[0]["fault"]) == (TRACKING, NO_FAULT)
    assert (error < share * uncompensated).all()
    assert not rows["axis"]["conditions"].any()
    fresh = float(np.mean(rows["axis"]["fresh"][:, 0] & 1))
    assert fresh == pytest.approx({"simulated_2khz": 0.2, "simulated_1khz": 0.1}[name], rel=1e-3)


@pytest.mark.parametrize("name", ["simulated_2khz", "simulated_1khz"])
def test_clocks_that_drift_past_each_other_do_no_harm(tmp_path, name):
    """Every phase between the ticks of both ways and the loop comes by in the run."""
    document = yaml.safe_load((CONFIG / f"{name}.yaml").read_text(encoding="utf-8"))
    bus = document["drivers"]["cell"]["bus"]
    bus["input_rate_Hz"], bus["output_rate_Hz"] = 0.997 * bus["input_rate_Hz"], 1.001 * bus["output_rate_Hz"]
    file = tmp_path / "cell.yaml"
    file.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    error, uncompensated, cell, _ = tracked(prepare(file))
    assert (cell.state[0]["state"], cell.state[0]["fault"]) == (TRACKING, NO_FAULT)
    assert (error < 0.05 * uncompensated).all()
