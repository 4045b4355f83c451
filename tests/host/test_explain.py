"""A trip in plain words: the order of causes, numbers that are right, bad files told in one line."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from micromanip.cli.main import cli
from micromanip.errors import UsageError
from micromanip.host.trips.evidence import error_um, observations
from micromanip.host.trips.report import lines, story
from micromanip.host.trips.store import file_name
from micromanip.rt.states import OVERRUNS, STAGE_INVALID, STRAIN, STRAIN_INVALID, TRACKING
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell

from .boxes import BEFORE, TRIP, box, event, tracking_rows
from .standin import SIMULATED


def seen(rows):
    return [(round(moment.ms, 1), moment.axis, moment.text) for moment in observations(box(rows))]


def test_the_order_of_causes():
    """Saturated, then an error that grows, then the gauge goes, deadlines are missed on the way: told in that order."""
    rows = tracking_rows()
    axis = rows["axis"]
    axis["voltage_V"][BEFORE - 312 : BEFORE + 1, 0] = 150.0
    axis["voltage_V"][BEFORE - 200 : BEFORE - 195, 0] = 149.0  # a short way off the end counts as at it
    axis["stage_um"][BEFORE - 50 : BEFORE, 0] = 93.0
    axis["fresh"][BEFORE - 3 :, 0] &= ~1
    rows["periods"][BEFORE - 20] = 4
    assert seen(rows) == [
        (-31.2, "x", "voltage at the end of its range, 150 V, for 31.2 ms"),
        (-5.0, "x", "error above what was usual (0.50 um), up to 7.00 um"),
        (-2.0, None, "3 deadlines missed"),
        (-0.3, "x", "strain gauge: no good sample any more"),
    ]


def test_story_has_trip_states_axes_and_configuration(tmp_path):
    rows = tracking_rows()
    rows["axis"]["voltage_V"][BEFORE - 3800 : BEFORE, 0] = 150.0
    config = tmp_path / "cell.yaml"
    config.write_text("schema_version: 2\n")
    told = box(rows)
    told.meta["path"], told.meta["sha256"] = str(config), hashlib.sha256(config.read_bytes()).hexdigest()
    result = story(told, tmp_path / "t.npz")
    assert (result["code"], result["axis"], result["value"]) == ("X-201", "x", 3.0)
    assert result["states"] == [{"ms": -2000.0, "state": "TRACKING"}, {"ms": 0.0, "state": "RAMPING"}]
    x, y = result["axes"]["x"], result["axes"]["y"]
    assert (x["error_um"], x["voltage_V"], x["range_V"], x["saturated_percent"]) == (0.5, 150.0, [-20.0, 150.0], 38.0)
    assert (y["error_um"], y["max_error_um"], y["saturated_percent"]) == (0.0, 0.0, 0.0)
    assert result["configuration"]["now"] == "unchanged"
    assert result["configuration"]["parameter_versions"] == [3]
    assert result["next_step"].startswith("Check the gauge")
    order = [(moment["ms"], moment["text"].split(":")[0]) for moment in result["timeline"]]
    assert order[-2:] == [(0.0, "X-201 axis x"), (0.0, "RAMPING")]
    text = "\n".join(lines(result))
    assert "150.0 V of -20 to 150 V, at an end of it 38 % of the last second" in text
    config.write_text("schema_version: 2\n# touched\n")
    assert story(told, tmp_path / "t.npz")["configuration"]["now"] == "changed"
    config.unlink()
    assert story(told, tmp_path / "t.npz")["configuration"]["now"] == "missing"


def test_faults_and_warnings_are_told_in_their_order(tmp_path):
    """What the loop noticed, with what it measured; the trip is at 0."""
    raised = [
        event(TRIP - 40_000, STAGE_INVALID, 0, 3.0, 3.0),  # of an earlier trip
        event(TRIP - 120, STAGE_INVALID, 1, 7.0, 3.0),
        event(TRIP, STRAIN_INVALID, 0, 4.0, 3.0),
        event(TRIP + 30, OVERRUNS, -1, 9.0, 3.0),
        event(TRIP + 40, 1000, -1, 2.5, 1.0),  # of a newer version
    ]
    told = story(box(events=raised), tmp_path / "t.npz")["timeline"]
    codes = [(moment["ms"], moment["axis"], moment["text"].split()[0]) for moment in told]
    found = [code for code in codes if code[2].startswith("X-")]
    assert found == [(-12.0, "y", "X-202"), (0.0, "x", "X-201"), (3.0, None, "X-102")]
    assert " 7 cycles" in next(moment["text"] for moment in told if moment["text"].startswith("X-202"))
    assert told[-1]["text"] == "event 1000, 2.5 (limit 1)"


@pytest.mark.compiled_only
def test_the_error_is_the_loops_own(tmp_path):
    """Behind a bus, where samples come rarely and late: as the loop knew it, not set-point of now less old sample."""
    document = yaml.safe_load((SIMULATED.parent / "simulated_1khz.yaml").read_text())
    truth = ("path_error", "uncompensated")
    document["signals"] = {n: entry for n, entry in document["signals"].items() if not n.startswith(truth)}
    file = tmp_path / "cell.yaml"
    file.write_text(yaml.safe_dump(document, sort_keys=False))
    prepared = prepare(file)
    cell = VirtualCell(prepared.parameters, prepared.wiring, prepared.samples)
    rows = np.concatenate([cell.arm(), cell.run(0.5)])
    told = box(rows)
    told = replace(told, parameters=prepared.parameters)
    tracking = rows["state"] == TRACKING
    for i in range(len(prepared.configuration.axes)):
        found, own = error_um(told, i)[tracking], rows["axis"]["path_error_um"][:, i][tracking]
        assert np.abs(own).max() > 0.1
        assert found == pytest.approx(own, abs=1e-9)
    gauge = prepared.parameters.copy()
    gauge["axis"]["mode"] = STRAIN
    for i in range(len(prepared.configuration.axes)):
        last = error_um(replace(told, parameters=gauge), i)[-1]
        assert last == pytest.approx(cell.state[0]["axis"][i]["strain_error_um"], abs=1e-9)


@pytest.fixture
def shelf(tmp_path):
    """A folder of two trips, the newer one of the whole loop, and one that is damaged."""
    names = []
    for seconds, code, axis in ((0, "X-201", "x"), (5, "X-104", None)):
        name = file_name(10**18 + seconds * 10**9, code, axis)
        message = {"seen": f"{code} happened", "message": f"{code} happened. Likely: x"}
        box(code=code, axis=axis, **message).save(tmp_path / name)
        names.append(name)
    (tmp_path / file_name(9 * 10**17, "X-102", None)).write_bytes(b"damaged")
    return tmp_path, names


def run(verb, *arguments):
    return CliRunner().invoke(cli, ["trip", verb, *map(str, arguments)])


def test_command_takes_the_newest_or_the_one_that_is_named(shelf):
    folder, names = shelf
    assert json.loads(run("show", "--trips", folder, "--json").stdout)["code"] == "X-104"
    assert json.loads(run("show", names[0][:-4], "--trips", folder, "--json").stdout)["code"] == "X-201"
    assert run("show", folder / names[0]).stdout.startswith("X-201 happened\n")


@pytest.mark.parametrize("number", [0, 1])
def test_the_page(shelf, tmp_path, number):
    """Of an axis with its sensor, and of the whole loop; nothing is replaced."""
    folder, names = shelf
    page = tmp_path / "trip.html"
    assert run("show", folder / names[number], "--to", page).exit_code == 0
    text = page.read_text()
    assert ("Axis x: gauge" in text, text.count("<figure>")) == ((True, 4), (False, 2))[number]
    assert isinstance(run("show", folder / names[number], "--to", page).exception, UsageError)
