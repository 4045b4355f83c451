"""One controller a device: the lock lives as long as any process that can move the outputs, and no longer."""

import os
import signal
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from pydantic import BaseModel

from micromanip.errors import DeviceUnavailable, PermissionDenied
from micromanip.io.contract import CyclicDriver
from micromanip.io.device_lock import DeviceLocks

from .cell import LOCKS_ELSEWHERE, WAITING, calm, changed

BENCH = ("    driver: simulated\n", "    driver: simulated\n    device: bench\n")


def test_second_is_refused_with_the_first_ones_number(tmp_path):
    with DeviceLocks(["can0"], tmp_path):
        with pytest.raises(DeviceUnavailable, match=rf"^device can0 is in use by .*process {os.getpid()}, .*stop it"):
            DeviceLocks(["can0"], tmp_path)
        with DeviceLocks(["can1"], tmp_path):
            pass
    with DeviceLocks(["can0"], tmp_path):
        pass


def test_all_or_none(tmp_path):
    with DeviceLocks(["b"], tmp_path):
        with pytest.raises(DeviceUnavailable, match="device b"):
            DeviceLocks(["c", "b", "a"], tmp_path)
        with DeviceLocks(["a", "c"], tmp_path) as others:
            assert len(others.descriptors) == 2


def test_it_lives_with_whoever_inherited_it(tmp_path):
    with DeviceLocks(["can0"], tmp_path) as locks:
        heir = subprocess.Popen(["sleep", "1000"], pass_fds=locks.descriptors)
    try:
        with pytest.raises(DeviceUnavailable, match="or the loop that it left"):
            DeviceLocks(["can0"], tmp_path)
    finally:
        heir.kill()
        heir.wait()
    DeviceLocks(["can0"], tmp_path).release()


def test_waiting_for_its_end(tmp_path):
    first = DeviceLocks(["can0"], tmp_path)
    timer = threading.Timer(0.2, first.release)
    timer.start()
    DeviceLocks(["can0"], tmp_path, wait_s=60.0).release()
    timer.join()


def test_names_of_devices_stay_in_the_folder(tmp_path):
    folder = tmp_path / "locks"
    with DeviceLocks(["/dev/comedi0", "../../etc/passwd", "192.168.0.7:502"], folder):
        assert sorted(file.name for file in folder.iterdir()) == [
            ".._.._etc_passwd.lock",
            "192.168.0.7_502.lock",
            "_dev_comedi0.lock",
        ]
    assert sorted(tmp_path.iterdir()) == [folder]


def test_a_folder_of_the_group_has_files_for_the_group_only(tmp_path):
    (tmp_path / "group").mkdir()
    (tmp_path / "group").chmod(0o2770)
    DeviceLocks(["can0"], tmp_path / "group").release()
    DeviceLocks(["can0"], tmp_path / "anybody").release()
    modes = [stat.S_IMODE((tmp_path / name / "can0.lock").stat().st_mode) for name in ("group", "anybody")]
    assert modes == [0o660, 0o666]
    assert stat.S_IMODE((tmp_path / "anybody").stat().st_mode) == 0o1777


def test_no_folder_no_lock_and_no_start(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(PermissionDenied, match=r"device can0 can't be locked .*docs/service.md"):
        DeviceLocks(["can0"], tmp_path / "file" / "locks")


class Card(CyclicDriver):
    """A driver that says no more than it must."""

    Options = BaseModel
    inputs = outputs = ()

    def __init__(self, options=None, period_ns=0):
        pass

    def context(self):
        return None

    def functions(self):
        return None


class Toy(Card):
    simulated = True


def test_a_driver_that_does_not_say_owns_one_device_of_its_kind():
    assert Card().device == "Card"
    assert Toy().device is None


def test_second_daemon_and_an_orphaned_loop(run, tmp_path):
    """The loop of a killed host still moves the outputs: nobody else may, until it has ended too."""
    folder = tmp_path / "locks"
    elsewhere = {"prefix": (sys.executable, "-c", LOCKS_ELSEWHERE, str(folder))}
    text = changed(calm(*WAITING), BENCH)
    first = run(text, **elsewhere).reach("READY")
    second = run(text, **elsewhere)
    assert second.wait() == 69
    assert second.said == (
        f"micromanip: device bench is in use by another controller (process {first.process.pid}, or the loop that it "
        "left); stop it first\n"
    )
    assert second.out == ""
    first.go_on(100)
    assert first.state == "READY"

    loop = first.loop
    os.kill(loop, signal.SIGSTOP)  # it can't ramp down, nor end
    first.process.kill()
    first.process.wait()
    third = run(text, **elsewhere)
    assert third.wait() == 69
    os.kill(loop, signal.SIGKILL)
    DeviceLocks(["bench"], folder, wait_s=60.0).release()
    assert [file.name for file in Path(folder).iterdir()] == ["bench.lock"]
    first.gone()  # its black box writes down the loop's death first
    first.socket.unlink()
