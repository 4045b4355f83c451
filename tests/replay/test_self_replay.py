"""A recorded run again: every number of every row bit for bit, whatever happened in it; and what is said where not."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cli.command import code_of
from settings.test_frame import SIMULATED, framed, prepared
from virtual.protected import Protected, text

from micromanip.errors import CheckFailed
from micromanip.replay import replay
from micromanip.rt.shadow import swap_cell
from micromanip.rt.states import ARM, DISARM, FAULT, HOLD, RESET, STOP, TRACKING
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell

from .recorded import recording

pytestmark = [pytest.mark.compiled_only, pytest.mark.long]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """All commands, stalls, and another tuning on the way: the rows, and their recording."""
    folder = tmp_path_factory.mktemp("replay")
    (folder / "cell.yaml").write_text(text())
    prepared = prepare(folder / "cell.yaml")
    cell = VirtualCell(prepared.parameters.copy(), prepared.wiring)
    other = prepared.parameters.copy()
    other["version"] += 1
    other["axis"]["pid"]["K_V_per_um"] *= 0.8
    rows = [cell.run(0.01), cell.run(1.8, command=ARM), cell.run(0.05, command=HOLD), cell.run(0.3, command=ARM)]
    swap_cell(cell.parameters[0], other[0], cell.state[0])
    cell.parameters[:] = other
    rows += [cell.run(0.2), cell.run(0.1, periods=3), cell.run(1.5, command=DISARM), cell.run(0.3, command=ARM)]
    rows += [cell.run(0.2, command=DISARM), cell.run(0.5, command=STOP)]
    sets = np.concatenate([prepared.parameters, other])
    rows = np.concatenate(rows)
    return prepared, rows, recording(folder / "run.mcap", prepared, rows, parameters=sets)


@pytest.fixture(scope="module")
def short(whole):
    """The beginning of it, before anything but the first arming: rows that tests may spoil."""
    prepared, rows, _ = whole
    return prepared, rows[:17_000]


def test_every_number_is_the_same(whole):
    _, rows, telemetry = whole
    outcome = replay(telemetry)
    assert outcome.difference is None
    assert (outcome.gaps, outcome.left_out) == ([], 0)
    assert outcome.cycles == outcome.rows == len(rows)
    assert outcome.commands == {"arm": 3, "hold": 1, "disarm": 2, "stop": 1}
    assert (outcome.skipped, outcome.swaps, outcome.is_other_version) == (2, 1, False)


@pytest.mark.parametrize(
    "fault",
    [
        "channel: strain_x, kind: nan",
        "channel: strain_x, kind: value, value: 175.0",
        "channel: strain_x, kind: freeze",
        "channel: strain_x, kind: spike, value: 500.0",
        "channel: stage_x, kind: status, for_s: 0.3",
        "channel: stage_x, kind: drop, for_s: 0.4",
        "channel: deviation_x, kind: drop",
        "channel: amplifier_ok_y, kind: value, value: 0.0",
        "channel: temperature_ok_x, kind: value, value: 0.0, for_s: 0.2",
        "channel: enable, kind: value, value: 0.0, for_s: 0.3",
        "channel: interlock, kind: value, value: 0.0",
        "channel: exchange, kind: error, value: 7, for_s: 0.01",
    ],
)
def test_what_sensors_and_devices_did_wrong_happens_again(tmp_path, fault):
    cell = Protected(fault)
    cell.run(0.7)
    if cell.s["state"] == FAULT:
        cell.before = np.concatenate([cell.before, cell.cell.run(0.05, command=RESET)])
    fresh = cell.before["axis"]["fresh"][19_990:]
    assert cell.s["events"] > 0 or (fresh >> 3 & ~fresh & 7).any(), "nothing came of the fault"
    outcome = replay(recording(tmp_path / "run.mcap", cell.prepared, cell.before))
    assert outcome.difference is None
    assert outcome.cycles == len(cell.before)


def test_a_tracker_that_is_turned_and_a_bus_that_is_slow(tmp_path):
    """Deviations that the loop computes itself; samples that come rarely and late."""
    slow = VirtualCell((bus := prepare(SIMULATED.with_name("simulated_2khz.yaml"))).parameters, bus.wiring)
    turned = VirtualCell((frame := prepared(tmp_path, framed(offset_um=[1.0, 0.0, 2.0]))).parameters, frame.wiring)
    for name, cell, made in (("slow", slow, bus), ("turned", turned, frame)):
        rows = np.concatenate([cell.arm(), cell.run(0.2)])
        assert rows["state"][-1] == TRACKING
        outcome = replay(recording(tmp_path / f"{name}.mcap", made, rows))
        assert (outcome.cycles, outcome.difference) == (len(rows), None)


def test_a_promotion_comes_behind_its_cycle(short, tmp_path):
    """The loop swaps after the cycle in which it promotes, and that cycle's row names the new set already."""
    prepared, _ = short
    cell = VirtualCell(prepared.parameters.copy(), prepared.wiring)
    rows = [cell.run(0.01), cell.run(1.8, command=ARM)]
    other = prepared.parameters.copy()
    other["version"] += 1
    other["axis"]["pid"]["K_V_per_um"] *= 0.5
    swap_cell(cell.parameters[0], other[0], cell.state[0])
    rows[-1]["version"][-1] = other["version"][0]
    cell.parameters[:] = other
    rows = np.concatenate([*rows, cell.run(0.1)])
    sets = np.concatenate([prepared.parameters, other])
    outcome = replay(recording(tmp_path / "run.mcap", prepared, rows, parameters=sets))
    assert outcome.difference is None
    assert (outcome.cycles, outcome.swaps) == (len(rows), 1)


def test_one_bit_is_found(short, tmp_path, capsys):
    prepared, rows = short
    rows = rows.copy()
    voltage = rows["axis"]["voltage_V"]
    was = voltage[16_000, 1]
    voltage[16_000, 1] = np.nextafter(was, np.inf)
    telemetry = recording(tmp_path / "run.mcap", prepared, rows)
    outcome = replay(telemetry)
    assert outcome.cycles == 16_000
    assert outcome.difference.cycle == rows["cycle"][16_000]
    assert outcome.difference.t_s == pytest.approx(1.6)
    assert outcome.difference.values == [("voltage_V", "y", voltage[16_000, 1], was)]
    assert outcome.difference.cause.startswith("the same sources compute something else here")

    assert code_of("replay", telemetry.file, "--json") == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["equal"], document["cycles"]) == (False, 16_000)
    assert document["difference"]["values"][0]["replayed"] == was
    assert code_of("replay", telemetry.file) == 1
    printed = capsys.readouterr().out
    assert f"cycle {rows['cycle'][16_000]}, 1.6000 s, differs:\n  voltage_V_y: recorded " in printed


def test_behind_a_gap_it_begins_anew_from_the_next_state(short, tmp_path, capsys):
    prepared, rows = short
    telemetry = recording(tmp_path / "run.mcap", prepared, np.delete(rows, slice(5000, 5012)))
    outcome = replay(telemetry)
    assert outcome.difference is None
    assert (outcome.cycles, outcome.left_out) == (5000, 17_000 - 5012)
    assert outcome.gaps == [f"12 cycles are missing behind cycle {rows['cycle'][4999]}"]
    assert code_of("replay", telemetry.file) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(
        "5000 cycles, 3 axes: every voltage equal, bit for bit (1 x arm)\ngap: 12 cycles are missing"
    )
    assert f"{17_000 - 5012} rows could not be replayed" in printed

    cell = VirtualCell(prepared.parameters.copy(), prepared.wiring)
    cell.run(0.01)
    cell.run(0.59, command=ARM)
    spoilt = np.delete(rows, slice(5000, 5012))
    again = replay(recording(tmp_path / "again.mcap", prepared, spoilt, kept=cell.state))
    assert again.difference is None
    assert (again.cycles, again.left_out) == (17_000 - 12 - 988, 988)
    assert again.gaps == outcome.gaps


@pytest.mark.parametrize("what", ["rows", "state", "parameters"])
def test_records_of_another_version_are_refused(short, tmp_path, what):
    prepared, rows = short
    telemetry = recording(tmp_path / "run.mcap", prepared, rows[:100])

    def narrower(records):
        return records[[name for name in records.dtype.names if name != "version"]]

    other = {
        "rows": lambda: map(narrower, telemetry.rows()),
        "state": narrower(telemetry.state),
        "parameters": [narrower(each) for each in telemetry.parameters],
    }
    with pytest.raises(CheckFailed, match=rf"run\.mcap: another version of micromanip recorded it, with other {what}"):
        replay(replace(telemetry, **{what: other[what]}))


def test_what_cannot_be_replayed_says_why(short, tmp_path):
    prepared, rows = short
    telemetry = recording(tmp_path / "run.mcap", prepared, rows[:100])
    with pytest.raises(CheckFailed, match=r"run\.mcap: nothing can be replayed, the loop's state is not in it"):
        replay(replace(telemetry, state=None))
    with pytest.raises(CheckFailed, match=r"replayed: the parameters of version \d+, .* are not in it"):
        replay(replace(telemetry, parameters=()))
    later = recording(tmp_path / "later.mcap", prepared, rows[50:100])
    with pytest.raises(CheckFailed, match="nothing can be replayed: no row follows a state of the loop"):
        replay(later)
    damaged = prepared.parameters.copy()
    damaged["axis"]["strain"][0, 1] = 1_000_000
    with pytest.raises(CheckFailed, match=r"damaged: its parameters have axis\.strain = "):
        replay(replace(telemetry, parameters=[damaged]))
