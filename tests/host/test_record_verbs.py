"""`recording start`, `stop`, `mark` on a running controller."""

import errno
import os
import resource

import numpy as np
import pytest

from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.errors import CheckFailed, UsageError
from micromanip.recordings import open_telemetry
from micromanip.replay import replay
from tests.cells import calm

from .standin import Cell


def all_rows(file):
    return np.concatenate(list(open_telemetry(file).rows()))


def missing(rows, dropped):
    """Whether there are gaps, as on a machine that stands still for seconds; then something was `dropped`."""
    gaps = np.diff(rows["cycle"]) - rows["periods"][1:]
    assert (gaps >= 0).all()
    assert dropped or not gaps.any()
    return bool(gaps.any())


def test_start_mark_stop(run, tmp_path):
    """A recording that reaches back, one whose disk is full, one that the run's end ends."""
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
        first = rows["cycle"][0] - ended["dropped"]
        assert first <= telemetry.state["cycle"] - 10_000  # a second before it was asked for
        assert [(mark["text"], mark["by"]) for mark in telemetry.marks[1:]] == [("coolant on", "root")]
        assert marked["cycle"] == telemetry.marks[1]["cycle"]
        assert telemetry.configuration == cell.config.read_text()
        if not missing(rows, ended["dropped"]):  # with gaps: tests/replay/test_gaps.py
            again = replay(telemetry)
            assert (again.difference, again.gaps) == (None, [])
            assert again.cycles + again.left_out == len(rows)
        with pytest.raises(UsageError, match=r"part17\.mcap is there already"):
            client.recording_start("part17")

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
        missing(rows, found["dropped"])
        cell.go_on(10_000)
        assert cell.state == "TRACKING"

        client.recording_start("plain")
        until(lambda: client.status()["recording"]["rows"] > 1000, cell.last_words)
        assert [e["verb"] for e in client.log()["entries"] if e["accepted"] and "record" in e["verb"]] == [
            "recording_start", "recording_mark", "recording_stop", "recording_start", "recording_start",
        ]  # fmt: skip
    assert cell.end() == 0
    missing(all_rows(tmp_path / "kept" / "plain.mcap"), cell.report["recording"]["dropped"])
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
        ({"segment_s": 60.0}, "segment_s and quota_bytes go together"),
        ({"before_s": 6.0}, "before_s"),
    ],
)
def test_a_wrong_request_is_refused(tmp_path, fields, said):
    with pytest.raises(UsageError, match=said):
        Cell(tmp_path)("recording_start", **fields)


def test_a_folder_that_can_t_be_made(tmp_path):
    (tmp_path / "recordings").write_text("a file")
    with pytest.raises(UsageError, match="recordings"):
        Cell(tmp_path)("recording_start", file="run")
