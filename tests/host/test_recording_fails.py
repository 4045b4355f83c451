"""A recorder that is killed, and a disk that fills: the control goes on, people are told, what was written is read."""

import errno
import os
import resource
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.errors import MicromanipError
from micromanip.host.control.socket_file import remove_stale
from micromanip.host.recording.hdf5_file import Hdf5Recording
from micromanip.host.recording.recording import require_new_file
from micromanip.host.recording.unclosed import checksum, close_unclosed
from micromanip.recordings import read_table
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE
from micromanip.rt.telemetry import ROW
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
    """Nobody is left to close the file: our own reader takes it as it is, others once it is mended.

    The old loop, still on its way to park, must not take the new host's socket away.
    """
    cell = run(calm(), "--record", "run.h5").reach("TRACKING")
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
    file = cell.folder / "run.h5"
    assert len(read_table(file)["t_s"]) >= 5000
    assert close_unclosed(file)
    assert len(recorded_rows(file)) >= 5000


def test_file_that_may_not_grow_and_then_a_recorder_killed(run):
    """Every user can have that: a limit of the size of files. What is recorded next fails in its own way."""
    cell = run(calm(), "--record", "run.h5", "--recordings", "kept").reach("TRACKING")
    until(lambda: recording_of(cell)["rows"] > 5000, cell.last_words)
    size = (cell.folder / "run.h5").stat().st_size + 2_000_000
    resource.prlimit(cell.child("recording.recorder"), resource.RLIMIT_FSIZE, (size, size))
    until(lambda: recording_of(cell)["state"] == "failed", cell.last_words)
    found = recording_of(cell)
    assert f"run.h5: {os.strerror(errno.EFBIG)}, nothing more is recorded" in found["message"]
    assert f"WARNING: {found['message']}" in cell.said
    rows = recorded_rows(cell.folder / "run.h5")
    assert found["rows"] == len(rows) > 5000
    with h5py.File(cell.folder / "run.h5") as recording:
        assert not recording.attrs["complete"]
        assert recording.attrs["problem"].decode() == os.strerror(errno.EFBIG)
    assert (cell.folder / "run.h5").stat().st_size <= size
    cell.go_on(GONE_ON_CYCLES)

    with Client(cell.socket) as client:
        client.record_start("next.h5")
    file = cell.folder / "kept" / "next.h5"
    until(lambda: recording_of(cell)["rows"] > 5000, cell.last_words)
    os.kill(cell.child("recording.recorder"), signal.SIGKILL)
    until(lambda: "next.h5 died, nothing more is recorded" in cell.said, cell.last_words)
    until(lambda: recording_of(cell)["state"] == "failed", cell.last_words)
    rows = recorded_rows(file)  # also while the controller runs
    assert len(rows) >= 5000
    assert end_failed(cell, "the recorder of kept/next.h5 died")["rows"] <= len(rows)
    assert len(read_table(file)["voltage_V_x"]) == len(rows)


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
        cell = run(calm(), "--record", str(disk / "run.h5"), prefix=inside).reach("TRACKING")
        until(lambda: recording_of(cell)["state"] == "failed", cell.last_words)
        found = end_failed(cell, f"{disk}/run.h5: {os.strerror(errno.ENOSPC)}")
        seen = f"/proc/{keeper}/root{disk}/run.h5"
        rows = recorded_rows(seen)
        assert found["rows"] == len(rows) >= 1000
        assert len(read_table(type(tmp_path)(seen))["t_s"]) == len(rows)


def begun(file, index=0):
    orders = {"file": str(file), "configuration": "", "sha256": "", "axes": ["x"], "period_ns": 100_000}
    recording = Hdf5Recording(orders)
    recording.begin(np.zeros(1, CELL_STATE)[0])
    return recording


def slots():
    sets = np.zeros(1, CELL_PARAMETERS)
    sets["version"] = 1
    return sets


def some_rows(first, count):
    rows = np.zeros(count, ROW)
    rows["cycle"], rows["periods"], rows["version"] = np.arange(first, first + count), 1, 1
    return rows


KILLED = """
import os, sys, numpy as np
from tests.host.test_recording_fails import begun, some_rows, slots
recording, first = begun(sys.argv[1]), 1
while True:
    recording.append(some_rows(first, 700), slots())
    if first == 1:
        print("begun", flush=True)
    first += 700
"""


@pytest.mark.live  # a process that is killed
@pytest.mark.parametrize("after_ms", [20, 333, *further(150, 800)])
def test_killed_in_the_middle_of_a_write(tmp_path, after_ms):
    """It writes without a pause: wherever the kill comes, the file is one row after the other."""
    file = tmp_path / "run.h5"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    writer = subprocess.Popen([sys.executable, "-c", KILLED, str(file)], stdout=subprocess.PIPE, env=environment)
    writer.stdout.readline()
    with pytest.raises(subprocess.TimeoutExpired):
        writer.wait(after_ms * 1e-3)
    writer.kill()
    writer.wait()
    writer.stdout.close()
    seen = read_table(file)["t_s"]  # as it is
    assert close_unclosed(file)
    with h5py.File(file) as recording:
        cycles = recording["rows"]["cycle"]
    assert (cycles == np.arange(1, len(cycles) + 1)).all()
    assert len(cycles) == len(seen) > 0
    assert len(cycles) % 700 == 0 or len(cycles) % 1000 == 0


@pytest.mark.parametrize("closed", [True, False])
def test_a_file_that_is_cut_off_is_refused_at_once(tmp_path, closed):
    """In a process of its own: read as a file that is being written, HDF5 waits for the rest, and can't be stopped."""
    recording = begun(tmp_path / "run.h5")
    recording.append(some_rows(1, 5000), slots())
    if closed:
        recording.close()
    content = (tmp_path / "run.h5").read_bytes()
    (tmp_path / "cut.h5").write_bytes(content[: len(content) // 2])
    read = "import pathlib, sys, micromanip.recordings as r; r.read_table(pathlib.Path(sys.argv[1]))"
    reader = [sys.executable, "-c", read, str(tmp_path / "cut.h5")]
    ended = subprocess.run(reader, capture_output=True, text=True, timeout=60, check=False)
    assert "CheckFailed" in ended.stderr
    assert "cut.h5: it is cut off, damaged, or no HDF5" in ended.stderr
    if not closed:
        assert len(read_table(tmp_path / "run.h5")["t_s"]) == 5000
        recording.close()


def test_lost_rows_are_told_in_the_file_before_it_ends(tmp_path):
    recording = begun(tmp_path / "run.h5")
    recording.append(some_rows(1, 100), slots())
    recording.note_lost(7)
    recording.append(some_rows(108, 100), slots())
    with h5py.File(tmp_path / "run.h5", swmr=True) as seen:
        assert seen.attrs["lost"] == 7
        assert len(seen["rows"]) == 200
        assert not seen.attrs["complete"]
    recording.close()


def test_a_recording_replaces_nothing(tmp_path):
    (tmp_path / "run.h5").write_text("precious")
    with pytest.raises(OSError, match="exist"):
        begun(tmp_path / "run.h5")
    assert (tmp_path / "run.h5").read_text() == "precious"


def test_checksum_is_hdf5s(tmp_path):
    """Of a file that HDF5 itself wrote; and what is none of its files is left alone."""
    file = tmp_path / "run.h5"
    begun(file).close()
    block = file.read_bytes()[:48]
    assert checksum(block[:44]) == int.from_bytes(block[44:], "little")
    for content in (b"", b"no HDF5 at all", block[:20], block[:44] + b"\0\0\0\0"):
        file.write_bytes(content)
        assert not close_unclosed(file)
        assert file.read_bytes() == content


TARGETS = {
    "an older recording": (lambda folder: (folder / "run.h5").write_bytes(b"precious"), 64, "is there already"),
    "a folder": (lambda folder: (folder / "run.h5").mkdir(), 64, "is not a file"),
    "a FIFO": (lambda folder: os.mkfifo(folder / "run.h5"), 64, "is not a file"),
    "a device": (lambda folder: (folder / "run.h5").symlink_to("/dev/null"), 64, "is not a file"),
    "a link to nowhere": (lambda folder: (folder / "run.h5").symlink_to(folder / "none"), 64, "is not a file"),
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
    before = unchanged(tmp_path / "run.h5")
    refused(tmp_path / "run.h5", [code], said)
    assert unchanged(tmp_path / "run.h5") == before


def test_a_folder_that_is_none_is_refused(tmp_path):
    refused(tmp_path / "no" / "run.h5", [64], f"mkdir -p {tmp_path}/no")
    (tmp_path / "file").touch()
    refused(tmp_path / "file" / "run.h5", [64], "there is no folder")


def test_a_folder_that_takes_no_file_is_refused():
    """Not even root makes a file there."""
    refused(Path("/proc/self/run.h5"), [64, 69, 77], ": ")


def test_a_refused_recording_starts_nothing(run, tmp_path):
    (tmp_path / "run.h5").write_bytes(b"precious")
    cell = run(calm(), "--record", str(tmp_path / "run.h5"))
    assert cell.wait() == 64
    (line,) = cell.said.splitlines()
    assert line.startswith(f"micromanip: --record {tmp_path}/run.h5 is there already")
    assert cell.report.keys() == {"error", "exit_code"}
    assert cell.left == []
