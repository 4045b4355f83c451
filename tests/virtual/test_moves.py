"""A held axis of the simulated cell is moved, in virtual time: as predicted, and as the set-point says."""

import numpy as np
import pytest

from micromanip.rt.states import ARM, DISARM, HOLD, HOLDING
from micromanip.settings.check import prepare
from micromanip.settings.move_plan import HeldAxis, MoveRequest, plan_move
from micromanip.virtual.experiment import VirtualExperiment
from tests.cells import calm

pytestmark = pytest.mark.long


def held_cell(prepared):
    cell = VirtualExperiment(prepared).cell(prepared.configuration, prepared.samples)
    cell.arm()
    cell.run(0.3, command=HOLD)
    return cell


def moved(prepared, cell, wanted, for_s=None):
    held = HeldAxis(cell.parameters[0]["axis"][0], cell.state[0]["axis"][0].copy())
    move = plan_move(prepared.configuration, "x", MoveRequest(**wanted), held)
    move.fill(cell.parameters[0]["axis"][0]["move"], 1)
    return cell.run(for_s or move.cycles * 1e-4 + 0.3), move


@pytest.fixture(scope="module")
def strain(tmp_path_factory):
    file = tmp_path_factory.mktemp("moves") / "cell.yaml"
    file.write_text(calm())
    return prepare(file)


@pytest.mark.parametrize(
    "wanted",
    [
        {"kind": "step", "by_um": 12.0},
        {"kind": "sine", "amplitude_um": 8.0, "frequency_Hz": 5.0, "seconds": 1.0},
        {"kind": "waypoints", "places_um": (5.0, -10.0, 20.0), "way_s": 0.3, "rest_s": 0.1},
    ],
    ids=lambda wanted: wanted["kind"],
)
def test_the_set_point_goes_as_planned_and_the_gauge_and_the_voltage_with_it(strain, wanted):
    cell = held_cell(strain)
    before = cell.state[0]["axis"][0]["setpoint_um"]
    rows, move = moved(strain, cell, wanted)
    axis = rows["axis"][:, 0]
    away = axis["setpoint_um"] - before
    path = move.looked_at()
    assert (away.min(), away.max()) == pytest.approx((path.min(), path.max()), abs=0.05)
    assert np.abs(away[-100:]).max() < 1e-6, "it ends where it began"
    assert np.abs(np.diff(axis["setpoint_um"])).max() <= 1.001 * move.fastest
    assert np.sqrt(np.mean((axis["strain_um"] - axis["setpoint_um"]) ** 2)) < 0.5
    others = rows["axis"][:, 1:]["setpoint_um"]
    assert np.ptp(others, axis=0).max() < 1e-9, "no other axis moves"
    assert (rows["state"] == HOLDING).all()
    assert not cell.faults()


@pytest.mark.parametrize("command", [ARM, DISARM])
def test_what_ends_the_hold_ends_the_move_and_nothing_jumps(strain, command):
    cell = held_cell(strain)
    rows, move = moved(strain, cell, {"kind": "step", "by_um": 30.0}, for_s=0.08)
    assert rows["axis"]["setpoint_um"][-1, 0] - rows["axis"]["setpoint_um"][0, 0] > 5.0, "in the middle of it"
    after = cell.run(0.5, command=command)
    assert cell.state[0]["axis"][0]["move"]["over"] == 1
    setpoints, volts = (
        np.r_[rows["axis"][name][-1:, 0], after["axis"][name][:, 0]] for name in ("setpoint_um", "voltage_V")
    )
    assert np.abs(np.diff(setpoints)).max() <= 1.1 * move.fastest
    noise_V = np.abs(np.diff(rows["axis"]["voltage_V"][:100, 0])).max()
    assert np.abs(np.diff(volts)).max() < 2.0 * noise_V + 2.0 * move.fastest
    cell.run(0.3, command=HOLD)
    assert cell.state[0]["axis"][0]["move"]["over"] == 1, "it does not go on by itself"
