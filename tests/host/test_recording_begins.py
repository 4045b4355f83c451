"""Whether a recording has begun is told as it is: on a full disk, without a snapshot, and where no answer comes."""

import asyncio
import errno
import json
import os
import resource
import socket
import threading
from pathlib import Path

import numpy as np
import pytest

from micromanip import client
from micromanip.errors import CheckFailed, DeviceUnavailable, MicromanipError
from micromanip.host.recording.recording import RecorderProcess
from micromanip.host.recording.recordings import looked_at
from micromanip.host.shared_memory import RING, Segments
from micromanip.rt.record import MAX_AXES
from micromanip.settings.check import prepare

from .standin import SIMULATED


class Turning:
    """A controller, as far as a recorder knows one; `snapshot` is what the loop does when it is to make one."""

    def __init__(self, snapshot):
        self.prepared, self.state = prepare(SIMULATED), "STARTING"
        self.segments = Segments.create(64, np.zeros((1, MAX_AXES)))
        self.ring = self.segments.ring.record(RING)
        self.snapshot, self.beat = snapshot, lambda: None


@pytest.mark.live  # a process of its own
def test_a_disk_that_takes_the_head_of_a_file_only(tmp_path):
    """It has begun once the file has what the rows follow; before that it has not, and leaves no file."""
    file = tmp_path / "run.mcap"

    async def full():
        size = file.stat().st_size
        resource.prlimit(recorder._child.pid, resource.RLIMIT_FSIZE, (size, size))
        return 1

    recorder = RecorderProcess(Turning(full), file, print)
    with pytest.raises(CheckFailed, match=f"^nothing is recorded: {file} can't be written: {os.strerror(errno.EFBIG)}"):
        asyncio.run(recorder.start())
    assert not recorder._child.runs
    assert list(tmp_path.iterdir()) == []


@pytest.mark.live  # a process of its own
def test_a_loop_that_makes_no_snapshot(tmp_path):
    """Nothing is left behind: no process that waits for it, and no file."""

    async def standing():
        raise CheckFailed("the loop made no snapshot within 1 s")

    recorder = RecorderProcess(Turning(standing), tmp_path / "run.mcap", print)
    with pytest.raises(CheckFailed, match=r"^nothing is recorded, as the state is STARTING: the loop made no snapshot"):
        asyncio.run(recorder.start())
    assert not recorder._child.runs
    assert list(tmp_path.iterdir()) == []


def test_an_answer_that_does_not_come(tmp_path, monkeypatch):
    """Neither done nor refused: that is told, and what comes later is no answer to the next request."""
    monkeypatch.setattr(client, "_TIMEOUT_S", 0.05)
    monkeypatch.setattr(client, "_LONGER_S", {"recording_start": 0.1})
    late = threading.Event()

    def serve():
        first, _ = listener.accept()
        with first, first.makefile("rb") as asked:
            asked.readline()
            late.wait()
            second, _ = listener.accept()
            with second, second.makefile("rb") as again:
                first.close()
                assert json.loads(again.readline())["verb"] == "status"
                second.sendall(b'{"ok": true, "result": "as it is"}\n')

    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "control"))
        listener.listen()
        serving = threading.Thread(target=serve)
        serving.start()
        with client.Client(tmp_path / "control") as cell:
            with pytest.raises(DeviceUnavailable, match=r"recording_start within 0\.1 s: .* is not known"):
                cell.recording_start()
            late.set()
            assert cell.status() == "as it is"
        serving.join()


def test_a_folder_that_does_not_answer():
    """Who looks at it is not waited for, and the event loop turns meanwhile."""
    released = threading.Event()

    async def main():
        with pytest.raises(DeviceUnavailable, match=r"^/srv/far did not answer within 0\.02 s: does its disk hang"):
            await looked_at(lambda: released.wait() and None, Path("/srv/far"), 0.02)

    asyncio.run(main())
    released.set()

    def refuses():
        raise CheckFailed("no")

    with pytest.raises(MicromanipError, match=r"^no$"):
        asyncio.run(looked_at(refuses, Path("/srv"), 5.0))
