"""A recorder that is killed, and a disk that fills: the control goes on, people are told, what was written is read."""

import errno
import os
import resource
import signal
import socket
import subprocess
from contextlib import contextmanager

import pytest

from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.errors import MicromanipError
from micromanip.host.control.socket_file import remove_stale
from micromanip.host.recording.recording import require_new_file
from micromanip.recordings import open_telemetry
from tests.cells import calm
from tests.further import further

from .recorded import recorded_rows, recording_of

GONE_ON_CYCLES = 20_000
"""Two seconds: more than the loop lives without a sign of life of its host."""


def end_failed(cell, said):
    """It tracked on meanwhile, and its end tells of the failure: exit code, last line, report; no traceback."""
    assert cell.state == "TRACKING"
    cell.go_on(GONE_ON_CYCLES)
    assert cell.state == "TRACKING"
    assert cell.end() == 1
    assert "Traceback" not in cell.said
    assert "Error" not in cell.said
    (last,) = [line for line in cell.said.splitlines() if line.startswith("micromanip: ")]
    assert said in last
    assert "nothing more is recorded" in last
    report = cell.report
    assert report["state"] == "OFF"
    assert report["faults"] == []
    assert report["recording"]["state"] == "failed"
    assert report["recording"]["message"] == last.removeprefix("micromanip: ")
    assert cell.said.count(f"WARNING: {report['recording']['message']}") >= 1
    assert cell.left == []
    return report["recording"]


def test_host_and_recorder_killed_and_another_host_started_at_once(run):
    """Nobody is left to close the file: it is read as it is.

    The old loop, still on its way to park, must not take the new host's socket away.
    """
    cell = run(calm(), "--record", "run.mcap").reach("TRACKING")
    until(lambda: recording_of(cell)["rows"] > 5000, cell.last_words)
    cell.process.send_signal(signal.SIGSTOP)
    os.kill(cell.child("recording.recorder"), signal.SIGKILL)
    cell.process.kill()
    cell.wait()
    remove_stale(cell.socket)  # what a new host does, and then:
    with socket.socket(socket.AF_UNIX) as new:
        new.bind(str(cell.socket))
        new.listen()
        assert cell.state != "OFF", "the loop was gone before there was a new socket"
        cell.gone()
        assert cell.socket.is_socket()
    cell.socket.unlink()
    assert len(recorded_rows(cell.folder / "run.mcap", 1e9)) >= 5000  # what it dropped last it could not tell


def test_file_that_may_not_grow_and_then_a_recorder_killed(run):
    """Every user can have that: a limit of the size of files. What is recorded next fails in its own way."""
    cell = run(calm(), "--record", "run.mcap", "--recordings", "kept").reach("TRACKING")
    until(lambda: recording_of(cell)["rows"] > 5000, cell.last_words)
    size = (cell.folder / "run.mcap").stat().st_size + 1_000_000
    resource.prlimit(cell.child("recording.recorder"), resource.RLIMIT_FSIZE, (size, size))
    until(lambda: recording_of(cell)["state"] == "failed", cell.last_words)
    found = recording_of(cell)
    assert f"run.mcap: {os.strerror(errno.EFBIG)}, nothing more is recorded" in found["message"]
    assert f"WARNING: {found['message']}" in cell.said
    rows = recorded_rows(cell.folder / "run.mcap", found["dropped"])
    assert found["rows"] == len(rows) > 5000
    assert open_telemetry(cell.folder / "run.mcap").end == {}
    assert (cell.folder / "run.mcap").stat().st_size <= size
    cell.go_on(GONE_ON_CYCLES)

    with Client(cell.socket) as client:
        client.recording_start("next.mcap")
    file = cell.folder / "kept" / "next.mcap"
    until(lambda: recording_of(cell)["rows"] > 5000, cell.last_words)
    os.kill(cell.child("recording.recorder"), signal.SIGKILL)
    until(lambda: "next.mcap died, nothing more is recorded" in cell.said, cell.last_words)
    until(lambda: recording_of(cell)["state"] == "failed", cell.last_words)
    rows = recorded_rows(file, 1e9)  # also while the controller runs; what it dropped last it could not tell
    assert len(rows) >= 5000
    assert end_failed(cell, "the recorder of kept/next.mcap died")["rows"] <= len(rows)


@contextmanager
def small_disk(folder, size):
    """A file system of `size` on `folder`, in a mount namespace of its own: its keeper, and the folder seen by us."""
    script = f"mount -t tmpfs -o size={size} none {folder} && echo ready && exec sleep 600"
    keeper = subprocess.Popen(
        ["unshare", "--mount", "sh", "-c", script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    try:
        yield keeper.pid if keeper.stdout.readline() == b"ready\n" else None
    finally:
        keeper.kill()
        keeper.wait()
        keeper.stdout.close()


@pytest.mark.parametrize("size", ["1m", *further("4m")])
def test_full_disk(run, tmp_path, size):
    """A real one where we may mount it; elsewhere the file that may not grow, above, stands for it."""
    disk = tmp_path / "disk"
    disk.mkdir()
    with small_disk(disk, size) as keeper:
        if keeper is None:
            pytest.skip("mounting a file system takes root")
        inside = ("nsenter", f"--target={keeper}", "--mount")
        cell = run(calm(), "--record", str(disk / "run.mcap"), prefix=inside).reach("TRACKING")
        until(lambda: recording_of(cell)["state"] == "failed", cell.last_words)
        found = end_failed(cell, f"{disk}/run.mcap: {os.strerror(errno.ENOSPC)}")
        seen = f"/proc/{keeper}/root{disk}/run.mcap"
        assert found["rows"] == len(recorded_rows(seen, found["dropped"])) > 0


TARGETS = {
    "an older recording": (lambda folder: (folder / "run.mcap").write_bytes(b"precious"), 64, "is there already"),
    "a folder": (lambda folder: (folder / "run.mcap").mkdir(), 64, "is not a file"),
    "a FIFO": (lambda folder: os.mkfifo(folder / "run.mcap"), 64, "is not a file"),
    "a device": (lambda folder: (folder / "run.mcap").symlink_to("/dev/null"), 64, "is not a file"),
    "a link to nowhere": (lambda folder: (folder / "run.mcap").symlink_to(folder / "none"), 64, "is not a file"),
}


def unchanged(path):
    """What a write, a removal or a replacement would change; looking at it does not."""
    status = path.lstat()
    return status.st_ino, status.st_mode, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def refused(file, codes, said):
    """In one line, with the exit code."""
    with pytest.raises(MicromanipError) as found:
        require_new_file(file)
    assert found.value.exit_code in codes
    assert str(found.value).startswith(f"--record {file}")
    assert said in str(found.value)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("target", TARGETS)
def test_what_is_there_is_refused(tmp_path, target):
    make, code, said = TARGETS[target]
    make(tmp_path)
    before = unchanged(tmp_path / "run.mcap")
    refused(tmp_path / "run.mcap", [code], said)
    assert unchanged(tmp_path / "run.mcap") == before


def test_a_folder_that_is_none_is_refused(tmp_path):
    refused(tmp_path / "no" / "run.mcap", [64], f"mkdir -p {tmp_path}/no")
    (tmp_path / "file").touch()
    refused(tmp_path / "file" / "run.mcap", [64], "there is no folder")


def test_a_refused_recording_starts_nothing(run, tmp_path):
    (tmp_path / "run.mcap").write_bytes(b"precious")
    cell = run(calm(), "--record", str(tmp_path / "run.mcap"))
    assert cell.wait() == 64
    (line,) = cell.said.splitlines()
    assert line.startswith(f"micromanip: --record {tmp_path}/run.mcap is there already")
    assert cell.report.keys() == {"error", "exit_code"}
    assert cell.left == []
