"""A recorded run again: every number of every row bit for bit, whatever happened in it; and what is said where not."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cli.command import code_of
from settings.test_frame import CONFIG, framed, prepared
from virtual.protected import Protected, text

from micromanip.errors import CheckFailed
from micromanip.recordings import open_telemetry
from micromanip.recordings.export import export
from micromanip.recordings.filed import FILED_PARAMETERS
from micromanip.replay import replay
from micromanip.replay.recorded import Recorded
from micromanip.rt.states import (
    ARM,
    DISARM,
    FAULT,
    HOLD,
    RESET,
    STOP,
    TRACKING,
)
from micromanip.rt.swap import swap_cell
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
    assert (outcome.skipped, outcome.swaps, outcome.lacks, outcome.is_other_version) == (2, 1, [], False)


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
    slow = VirtualCell((bus := prepare(CONFIG.with_name("simulated_2khz.yaml"))).parameters, bus.wiring)
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


def test_another_sample_is_found_by_what_it_does(short, tmp_path):
    prepared, rows = short
    rows = rows.copy()
    rows["axis"]["strain_um"][15_500, 2] += 1e-9
    difference = replay(recording(tmp_path / "run.mcap", prepared, rows)).difference
    assert difference.cycle == rows["cycle"][15_500]
    assert {value.axis for value in difference.values} == {"z"}
    assert "voltage_V" in [value.name for value in difference.values]


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
    export(open_telemetry(tmp_path / "again.mcap"), tmp_path / "again.h5")
    assert replay(open_telemetry(tmp_path / "again.h5")) == again
    assert again.gaps == outcome.gaps


def test_rows_from_before_the_state_are_left_out(short, tmp_path):
    prepared, rows = short
    cell = VirtualCell(prepared.parameters.copy(), prepared.wiring)
    cell.run(0.01)
    cell.run(0.2, command=ARM)
    outcome = replay(recording(tmp_path / "run.mcap", prepared, rows, state=cell.state))
    assert outcome.difference is None
    assert (outcome.left_out, outcome.cycles) == (2100, 17_000 - 2100)


def test_rows_of_an_older_version_are_replayed_as_far_as_they_say(short, tmp_path):
    """Bits for what came and was not usable are not in them: a stage that stood at its end before arming is unknown."""

    def recorded(cell, name, begun, rows):
        rows["axis"]["fresh"] &= 7
        rows["lines"] &= 31
        return replace(recording(tmp_path / name, prepared, rows, state=begun), sources="")

    prepared, _ = short
    cell = VirtualCell(prepared.parameters.copy(), prepared.wiring)
    cell.run(0.01)
    cell.run(1.7, command=ARM)
    begun = cell.state.copy()
    outcome = replay(recorded(cell, "run.mcap", begun, cell.run(0.1)))
    assert (outcome.cycles, outcome.difference) == (1000, None)
    assert outcome.lacks[0] == "samples that came and were not usable"

    cell = Protected("channel: strain_x, kind: nan, for_s: 0.002")
    begun, prepared = cell.cell.state.copy(), cell.prepared
    outcome = replay(recorded(cell, "nan.mcap", begun, cell.run(0.1)))
    assert outcome.difference is not None
    assert outcome.difference.cause.startswith("an older version recorded it, and its rows do not say: samples that")


def test_records_of_another_version_are_carried_over_by_name(short, tmp_path):
    prepared, rows = short
    telemetry = recording(tmp_path / "run.mcap", prepared, rows[:3000])
    fields = [(name, *telemetry.state.dtype.fields[name][:1]) for name in telemetry.state.dtype.names]
    old = np.zeros(1, np.dtype([*[f for f in fields if f[0] != "trial_rest"], ("bygone", "f8")]))
    for name in set(old.dtype.names) - {"bygone"}:
        old[name] = telemetry.state[name]
    outcome = replay(replace(telemetry, state=old))
    assert (outcome.cycles, outcome.difference) == (3000, None)
    assert outcome.is_other_version


def without(records, *names):
    """`records` as a version had them that did not know the fields `names`, wherever they stand."""
    if records.dtype.names is None:
        return records
    kept = {name: without(records[name], *names) for name in records.dtype.names if name not in names}
    fields = [(name, each.dtype, each.shape[records.ndim :]) for name, each in kept.items()]
    older = np.zeros(records.shape, fields)
    for name, each in kept.items():
        older[name] = each
    return older


def test_rows_without_the_frequencies_that_were_found_are_replayed(short, tmp_path):
    prepared, rows = short
    telemetry = recording(tmp_path / "run.mcap", prepared, rows[:3000])
    found = ("tooth_Hz", "joint_1_Hz", "joint_2_Hz", "joint_3_Hz", "learned_um")
    older = replace(telemetry, rows=lambda: (without(part, *found) for part in telemetry.rows()))
    outcome = replay(older)
    assert (outcome.cycles, outcome.difference) == (3000, None)


def test_what_an_older_version_did_not_know_is_not_wired(short, tmp_path):
    """The first signal is no tool, and the first output no reset, because the parameters do not speak of them."""
    prepared, rows = short
    telemetry = recording(tmp_path / "run.mcap", prepared, rows[:100])
    unknown = ("tool", "learned_tool", "amplifier_reset", "reset_cycles", "stage", "horizon_cycles")
    older = Recorded(replace(telemetry, parameters=[without(each, *unknown) for each in telemetry.parameters]))
    (found,) = older.parameters.values()
    assert (found[0]["tool"]["signal"], found[0]["amplifier_reset"]) == (-1, -1)
    assert found[0]["axis"]["stage"].tolist() == [-1, -1, -1]
    assert found[0]["reset_cycles"] == 0
    assert "parameters.tool" in older.unlike


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
        replay(replace(telemetry, parameters=[damaged.view(FILED_PARAMETERS)]))


def test_what_the_axes_followed_is_in_it(tmp_path):
    source = text()
    begin = source.index("  source: ")
    (tmp_path / "wave.csv").write_text("x,y,z\n0,0,0\n20,-10,5\n0,0,0\n")
    played = "  source: file\n  path: wave.csv\n  sample_rate_Hz: 20\n"
    (tmp_path / "cell.yaml").write_text(source[:begin] + played + source[source.index("\naxes:") :])
    prepared = prepare(tmp_path / "cell.yaml")
    cell = VirtualCell(prepared.parameters, prepared.wiring, prepared.samples)
    rows = np.concatenate([cell.run(0.01), cell.run(1.9, command=ARM)])
    assert np.ptp(rows["axis"]["reference_um"][rows["state"] == TRACKING]) > 10.0
    outcome = replay(recording(tmp_path / "run.mcap", prepared, rows, samples=prepared.samples))
    assert outcome.difference is None
    assert outcome.cycles == len(rows)
    export(open_telemetry(tmp_path / "run.mcap"), tmp_path / "run.h5")
    assert replay(open_telemetry(tmp_path / "run.h5")) == outcome
    with pytest.raises(CheckFailed, match="an axis follows a file, and what that holds is not in the recording"):
        replay(recording(tmp_path / "without.mcap", prepared, rows))
