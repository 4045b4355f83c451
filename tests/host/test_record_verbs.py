"""`recording start`, `stop`, `mark` on a running controller, and which rows a trigger takes."""

import errno
import os
import resource

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.errors import CheckFailed, UsageError
from micromanip.host.recording.window import FAULT, MARK, OVERRUN, Window
from micromanip.recordings import open_telemetry
from micromanip.replay import replay
from micromanip.rt.records import CELL_STATE
from micromanip.rt.telemetry import ROW
from tests.cells import calm

from .standin import Cell


def all_rows(file):
    return np.concatenate(list(open_telemetry(file).rows()))


def missing(rows):
    """Cycles that the recorder was too late for: none but on a machine that stands still for seconds."""
    gaps = np.diff(rows["cycle"]) - rows["periods"][1:]
    assert (gaps >= 0).all()
    return gaps.sum()


def test_start_mark_stop(run, tmp_path):
    """A recording that reaches back, one that waits for a mark, one whose disk is full, one that the run's end ends."""
    cell = run(calm(), "--recordings", str(tmp_path / "kept")).reach("TRACKING")
    cell.go_on(12_000)
    with Client(cell.socket) as client:
        assert client.status()["recording"] is None
        with pytest.raises(CheckFailed, match=r"^nothing is being recorded; "):
            client.recording_stop()

        began = client.recording_start("part17", before_s=1.0)
        file = tmp_path / "kept" / "part17.mcap"
        assert (began["file"], began["state"]) == (str(file), "recording")
        with pytest.raises(CheckFailed, match=r"part17\.mcap is being recorded; stop that first"):
            client.recording_start("other")
        marked = client.recording_mark("coolant on")
        until(lambda: client.status()["recording"]["rows"] > 12_000, cell.last_words)
        ended = client.recording_stop()
        assert (ended["state"], ended["marks"]) == ("complete", 1)
        assert ended["bytes"] == pytest.approx(file.stat().st_size, rel=0.2)
        rows, telemetry = all_rows(file), open_telemetry(file)
        assert len(rows) == ended["rows"]
        assert missing(rows) <= ended["dropped"]
        first = rows["cycle"][0] - ended["dropped"]
        assert first <= telemetry.state["cycle"] - 10_000  # a second before it was asked for
        assert [(mark["text"], mark["by"]) for mark in telemetry.marks[1:]] == [("coolant on", "root")]
        assert marked["cycle"] == telemetry.marks[1]["cycle"]
        assert telemetry.configuration == cell.config.read_text()
        again = replay(telemetry)
        assert again.difference is None
        assert bool(again.gaps) == bool(missing(rows))
        assert again.cycles + again.left_out == len(rows)
        with pytest.raises(UsageError, match=r"part17\.mcap is there already"):
            client.recording_start("part17")

        client.recording_start("waits.mcap", triggers=["mark", "fault"], before_s=0.3, after_s=0.2)
        assert client.status()["recording"]["waits_for"] == ["mark", "fault"]
        cell.go_on(5_000)
        client.recording_mark("now")
        until(lambda: client.status()["recording"]["state"] == "complete", cell.last_words)
        rows, telemetry = all_rows(tmp_path / "kept" / "waits.mcap"), open_telemetry(tmp_path / "kept" / "waits.mcap")
        at = telemetry.marks[-1]["cycle"]
        dropped = client.status()["recording"]["dropped"]
        assert missing(rows) <= dropped
        assert at - 3000 <= rows["cycle"][0] <= at - 3000 + rows["periods"][0] + dropped
        assert at + 2000 - 1000 <= rows["cycle"][-1] <= at + 2000  # an overrun may skip the last of them

        client.recording_start("limited")
        limited = tmp_path / "kept" / "limited.mcap"
        until(lambda: client.status()["recording"]["rows"] > 3000, cell.last_words)
        size = limited.stat().st_size + 300_000
        resource.prlimit(cell.child("recording.recorder"), resource.RLIMIT_FSIZE, (size, size))
        until(lambda: client.status()["recording"]["state"] == "failed", cell.last_words)
        found = client.status()["recording"]
        assert f"limited.mcap: {os.strerror(errno.EFBIG)}, nothing more is recorded" in found["message"]
        assert f"WARNING: {found['message']}" in cell.said
        rows = all_rows(limited)
        assert len(rows) == found["rows"]
        assert missing(rows) <= found["dropped"]
        cell.go_on(10_000)
        assert cell.state == "TRACKING"

        client.recording_start("plain")
        until(lambda: client.status()["recording"]["rows"] > 1000, cell.last_words)
        assert [e["verb"] for e in client.log()["entries"] if e["accepted"] and "record" in e["verb"]] == [
            "recording_start", "recording_mark", "recording_stop",
            "recording_start", "recording_mark", "recording_start", "recording_start",
        ]  # fmt: skip
    assert cell.end() == 0
    assert missing(all_rows(tmp_path / "kept" / "plain.mcap")) <= cell.report["recording"]["dropped"]
    assert open_telemetry(tmp_path / "kept" / "plain.mcap").end["rows"] == cell.report["recording"]["rows"]
    assert cell.report["recording"]["state"] == "complete"
    assert "Traceback" not in cell.said


PLACES = ("../run", "/tmp/run.mcap", "folder/run.mcap", ".hidden.mcap", "..", "run\n.mcap", "x" * 100 + ".mcap")


@pytest.mark.parametrize("name", PLACES)
def test_a_client_names_no_place(tmp_path, name):
    """The controller may run with other rights than who asks."""
    cell = Cell(tmp_path)
    with pytest.raises(UsageError, match="is no name of a recording"):
        cell("recording_start", file=name)
    assert not (tmp_path / "recordings").exists()
    assert cell.entries[-1][:2] == ("recording_start", False)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"file": "run.csv"}, "a recording is an MCAP file"),
        ({"file": "run.h5"}, "a recording is an MCAP file"),
        ({"triggers": ["fault"]}, "triggers and after_s go together"),
        ({"after_s": 1.0}, "triggers and after_s go together"),
        ({"before_s": 6.0}, "before_s"),
        ({"triggers": ["sunrise"], "after_s": 1.0}, "triggers"),
    ],
)
def test_a_wrong_request_is_refused(tmp_path, fields, said):
    with pytest.raises(UsageError, match=said):
        Cell(tmp_path)("recording_start", **fields)


def test_a_folder_that_can_t_be_made(tmp_path):
    (tmp_path / "recordings").write_text("a file")
    with pytest.raises(UsageError, match="recordings"):
        Cell(tmp_path)("recording_start", file="run")


def rows_with(count, fault=None, overrun=None):
    rows = np.zeros(count, ROW)
    rows["cycle"], rows["periods"] = np.arange(100, 100 + count), 1
    if fault is not None:
        rows["fault"][fault:] = 7
    if overrun is not None:
        rows["periods"][overrun] = 3
    return rows


@given(st.integers(1, 400), st.integers(0, 300), st.integers(0, 300), st.lists(st.integers(0, 1000), max_size=8))
def test_a_trigger_is_exact_to_the_cycle(at, before, after, cuts):
    """However the rows come in."""
    window = Window([FAULT], before, after)
    taken = []
    for part in np.split(rows_with(1000, fault=at), sorted(cuts)):
        taken += window.take(part)
    found = np.concatenate(taken)["cycle"]
    assert (found == np.arange(100 + max(0, at - before), 100 + at + after + 1)).all()
    assert (window.cause, window.trigger_cycle) == (FAULT, 100 + at)
    assert window.is_over(100 + at + after)
    assert not window.is_over(100 + at + after - 1)


def test_the_first_of_several_triggers():
    window = Window([FAULT, OVERRUN], 2, 3)
    (found,) = window.take(rows_with(50, fault=30, overrun=20))
    assert list(found["cycle"]) == list(range(118, 124))
    assert window.cause == OVERRUN


def test_a_fault_that_was_there_before_triggers_nothing():
    window = Window([FAULT], 2, 3)
    assert window.take(rows_with(50, fault=0)) == []
    assert window.is_armed
    cleared = rows_with(50, fault=40)
    cleared["cycle"] += 50
    (first, second) = window.take(cleared)
    assert list(np.concatenate([first, second])["cycle"]) == list(range(188, 194))


def test_a_mark_that_comes_late():
    """The rows behind it are there already."""
    window = Window([MARK], 20, 10)
    for first in range(0, 3000, 100):
        part = rows_with(100)
        part["cycle"] += first
        assert window.take(part) == []
    window.marked(2000)
    assert list(np.concatenate(window.take(rows_with(0)))["cycle"]) == list(range(1980, 2011))


def test_states_wait_with_the_rows():
    """Those of which a row is recorded that follows it; all of them where nothing is waited for."""
    window = Window([FAULT], 50, 20)
    for cycle in (120, 149, 160):
        window.keep(state_at(cycle))
    assert window.states() == []
    window.take(rows_with(200, fault=100))
    assert [state["cycle"] for state in window.states()] == [149, 160]
    window.keep(state_at(210))
    assert [state["cycle"] for state in window.states()] == [210]
    assert window.states() == []

    window = Window([], 0, 0)
    window.keep(state_at(7))
    assert [state["cycle"] for state in window.states()] == [7]


def state_at(cycle):
    state = np.zeros(1, CELL_STATE)[0]
    state["cycle"] = cycle
    return state
