"""A trip leaves its black box, whoever dies, stands still or finds no room; a reset waits for it."""

import json
import os
import signal

import numpy as np
import pytest

from campaigns.running_controller import reset, until
from micromanip.client import Client
from micromanip.errors import CheckFailed
from micromanip.host.trips.store import TripRecord, trips
from micromanip.rt.states import RAMPING, TRACKING
from tests.cells import calm

from .black_boxes import assert_whole, box_of, explained, folder


def failing(at_s):
    """The calm cell at half its rate, for less CPU; the gauge of axis y fails for a second."""
    fault = f"    faults: [{{channel: strain_y, kind: nan, at_s: {at_s}, for_s: 1}}]\n"
    return calm(("rate_hz: 10000", "rate_hz: 5000"), ("    seed: 1\n", "    seed: 1\n" + fault))


def test_a_loop_killed_within_a_trip_tells_each_once_with_its_own_box(run):
    cell = run(failing(4.0)).reach("TRACKING")
    until(lambda: cell.child("trips.process"), cell.last_words)
    cell.reach("RAMPING")
    os.kill(cell.loop, signal.SIGKILL)
    assert cell.wait() == 1
    files = {file.stem.split("_")[1]: file for file in trips(folder(cell))}
    assert files.keys() == {"X-201", "X-104"}
    for code, file in files.items():
        (line,) = (line for line in cell.said.splitlines() if line.removeprefix("micromanip: ").startswith(code))
        assert line.endswith(f"Black box: {file}")


def test_trip_is_on_disk_before_a_reset(run):
    """The black box is held up: no reset; it goes on: nothing is missing, for the ring remembers."""
    cell = run(failing(2.3)).reach("TRACKING")
    helper = until(lambda: cell.child("trips.process"), cell.last_words)
    until(lambda: cell.cycles > 7_500, cell.last_words)  # it has started
    os.kill(helper, signal.SIGSTOP)
    try:
        cell.reach("FAULT")
        with Client(cell.socket) as client:
            with pytest.raises(CheckFailed, match=r"^reset refused: the black box of this trip is not on disk yet"):
                client.reset()
            assert cell.state == "FAULT"
            assert trips(folder(cell)) == []
            os.kill(helper, signal.SIGCONT)
            reset(client)
            box = box_of(cell, complete=False)
            assert client.status()["trips"][0]["file"] == str(trips(folder(cell))[0])
    finally:
        os.kill(helper, signal.SIGCONT)
    box = box_of(cell)
    assert_whole(box, 2000.0, 500.0)
    assert (box.trip["code"], box.trip["axis"]) == ("X-201", "y")
    at = int(np.searchsorted(box.rows["cycle"], box.trip["cycle"]))
    assert box.rows["fault"][at - 1] == 0
    assert (box.rows["fault"][at:][:1500] == box.trip["number"]).all()
    assert box.rows["state"][at - 1] == TRACKING
    assert RAMPING in box.rows["state"][at:]
    assert box.meta["configuration"] == cell.config.read_text()
    assert box.parameters["version"].tolist() == [1]
    assert box.parameters["axis"]["pid"]["K_V_per_um"][0, 0] == 0.6
    assert box.state[0]["cycle"] >= box.trip["cycle"]
    told = json.loads(explained(cell, "--json"))
    assert (told["code"], told["axis"], told["configuration"]["now"]) == ("X-201", "y", "unchanged")
    texts = [(moment["ms"], moment["axis"], moment["text"]) for moment in told["timeline"]]
    pause = next(t for t in texts if t[1] == "y" and "strain gauge: no good sample" in t[2])
    assert -20.0 < pause[0] < 0.0
    assert [state["state"] for state in told["states"]][:3] == ["ARMING", "TRACKING", "RAMPING"]
    assert cell.end() == 0
    assert cell.left == []
    assert "X-201 axis y: " in cell.said
    assert [file.name for file in folder(cell).iterdir()] == [file.name for file in trips(folder(cell))]


def test_black_box_killed_between_its_halves_and_the_host_gone_while_a_fault_is_latched(run):
    """The half that it had written is completed by the one that follows.

    What ends the run is told, and kept, as well: it would look as if the first fault had.
    """
    cell = run(failing(2.3)).reach("TRACKING")
    until(lambda: trips(folder(cell)), cell.last_words)
    os.kill(cell.child("trips.process"), signal.SIGKILL)
    assert not box_of(cell, complete=False).meta["complete"]
    assert_whole(box_of(cell), 2000.0, 500.0)
    cell.reach("FAULT")
    until(lambda: "X-201 axis y: " in cell.said, cell.last_words)
    os.kill(cell.process.pid, signal.SIGSTOP)
    try:
        until(lambda: cell.state == "OFF", lambda: f"the loop's end without its host, it is {cell.state}")
        until(lambda: len(trips(folder(cell))) == 2, "its black box")
    finally:
        os.kill(cell.process.pid, signal.SIGCONT)
    assert cell.wait() == 1
    assert [fault[:5] for fault in cell.report["faults"]] == ["X-201", "X-101"]
    assert [trip["complete"] for trip in cell.report["trips"]] == [True, True]
    said = cell.said.splitlines()
    assert len([line for line in said if "X-101 no sign of life from the host" in line]) == 1
    assert said[-1].startswith("micromanip: ended by X-101 after X-201 on axis y, as said above; ")
    boxes = {box.trip["code"]: box for box in map(TripRecord.load, trips(folder(cell)))}
    assert boxes.keys() == {"X-201", "X-101"}
    ended = boxes["X-101"]
    at = int(np.searchsorted(ended.rows["cycle"], ended.trip["cycle"]))
    assert ended.rows["fault"][at - 1] == boxes["X-201"].trip["number"]
    assert ended.rows["fault"][at] == ended.trip["number"]
    assert cell.left == []


def test_no_room_and_a_black_box_that_dies(run, tmp_path):
    """It is started again; what can't be written is said, kept, and written once there is room."""
    blocked = tmp_path / "state"
    blocked.write_text("a file where the folder should be")
    place = blocked / "trips"
    cell = run(failing(4.0), "--trips", str(place)).reach("TRACKING")
    first = until(lambda: cell.child("trips.process"), cell.last_words)
    os.kill(first, signal.SIGKILL)
    until(lambda: "the black box process died; it is started again" in cell.said, cell.last_words)
    cell.reach("FAULT")
    until(lambda: "the black box of X-201 can't be written to" in cell.said, cell.last_words)
    with Client(cell.socket) as client:
        assert client.status()["trips"][0]["problem"] == "Not a directory"
        reset(client)
    cell.reach("READY")
    blocked.unlink()
    box = box_of(cell, place=place)
    assert box.trip["code"] == "X-201"
    assert_whole(box, 2000.0, 500.0)
    until(lambda: f"Black box: {trips(place)[0]}" in cell.said, cell.last_words)
    assert cell.end() == 0
    assert cell.left == []
