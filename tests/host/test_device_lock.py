"""One controller a device: the lock lives as long as any process that can move the outputs, and no longer."""

import os
import re
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import pytest

from campaigns.fault_cells import CELLS
from micromanip.bus.device_lock import DeviceLocks
from micromanip.errors import ConfigError, DeviceUnavailable, PermissionDenied
from micromanip.settings.check import prepare
from tests.cells import LEISURELY, LOCKS_ELSEWHERE, WAITING, changed

BENCH = ("driver: simulated,", "driver: simulated, device: bench,")


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


def test_both_interfaces_of_a_ring_are_locked_and_no_other_driver_may_have_one(tmp_path):
    file, far = tmp_path / "cell.yaml", f"ecr{os.getpid()}b"
    file.write_text(CELLS["ring"]())
    devices = prepare(file).wiring.devices
    assert devices == {f"ethercat ecr{os.getpid()}", f"ethercat {far}"}
    with DeviceLocks([f"ethercat {far}"], tmp_path), pytest.raises(DeviceUnavailable, match=f"device ethercat {far}"):
        DeviceLocks(devices, tmp_path)
    other = f"  other:\n    driver: ethercat\n    interface: {far}\n    simulated: true\n"
    other += "    terminals: {only: {vendor: 1, product: 1}}\n"
    file.write_text(CELLS["ring"]().replace("signals:\n", f"{other}signals:\n"))
    with pytest.raises(ConfigError, match=f"driver cell owns ethercat {far} already; one driver has a device alone"):
        prepare(file)


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
    (tmp_path / "group").chmod(0o3770)
    DeviceLocks(["can0"], tmp_path / "group").release()
    DeviceLocks(["can0"], tmp_path / "anybody").release()
    modes = [stat.S_IMODE((tmp_path / name / "can0.lock").stat().st_mode) for name in ("group", "anybody")]
    assert modes == [0o660, 0o666]
    assert stat.S_IMODE((tmp_path / "anybody").stat().st_mode) == 0o1777


def test_no_folder_no_lock_and_no_start(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(PermissionDenied, match=r"device can0 can't be locked .*docs/your-cell.md"):
        DeviceLocks(["can0"], tmp_path / "file" / "locks")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("tcp localhost:50000", "tcp 127.0.0.1:50000"),
        ("tcp 127.0.0.1:50000", "tcp [::1]:50000"),
        ("udp 0:5500", "udp 127.0.0.1:5500"),
        ("socketcan-lo", "socketcan-other_name_of_lo"),
        ("NODE", "BY-ID"),
    ],
)
def test_a_device_is_locked_by_what_it_is(tmp_path, monkeypatch, first, second):
    (tmp_path / "NODE").touch()
    (tmp_path / "BY-ID").symlink_to("NODE")
    ask = socket.if_nametoindex
    monkeypatch.setattr(socket, "if_nametoindex", lambda name: ask("lo" if name == "other_name_of_lo" else name))
    first, second = (str(tmp_path / name) if name.isupper() or name == "BY-ID" else name for name in (first, second))
    locks = tmp_path / "locks"
    with DeviceLocks([first], locks), pytest.raises(DeviceUnavailable, match=f"device {re.escape(second)} is in use"):
        DeviceLocks([second], locks)
    with DeviceLocks([first, second], locks):  # the same one twice is no contradiction
        pass


def test_it_stays_locked_where_it_was_plugged_in_anew_under_another_number(tmp_path):
    (tmp_path / "tty0").touch()
    (tmp_path / "by-id").symlink_to("tty0")
    with DeviceLocks([str(tmp_path / "by-id")], tmp_path / "locks"):
        (tmp_path / "by-id").unlink()
        (tmp_path / "by-id").symlink_to("tty1")
        with pytest.raises(DeviceUnavailable):
            DeviceLocks([str(tmp_path / "by-id")], tmp_path / "locks")


@pytest.mark.parametrize(
    ("mode", "owner", "said"),
    [
        (0o1777, 4711, "belongs to user 4711, neither root nor you"),
        (0o700, 4711, "belongs to user 4711"),
        (0o777, 0, "can be changed by everybody and is not sticky"),
    ],
)
def test_a_folder_of_somebody_else_locks_nothing(tmp_path, mode, owner, said):
    folder = tmp_path / "locks"
    folder.mkdir()
    folder.chmod(mode)
    os.chown(folder, owner, owner)
    with pytest.raises(PermissionDenied, match=said):
        DeviceLocks(["can0"], folder)
    assert list(folder.iterdir()) == []


def test_a_link_in_place_of_the_folder_is_not_followed(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "locks").symlink_to("elsewhere")
    with pytest.raises(PermissionDenied, match="can't be locked"):
        DeviceLocks(["can0"], tmp_path / "locks")
    assert list((tmp_path / "elsewhere").iterdir()) == []


@pytest.mark.parametrize("plant", [os.symlink, os.link, lambda _, path: os.mkfifo(path)])
def test_what_was_planted_in_place_of_a_lock_is_not_touched(tmp_path, plant):
    (tmp_path / "victim").write_text("precious")
    (tmp_path / "locks").mkdir(mode=0o755)
    plant(tmp_path / "victim", tmp_path / "locks" / "can0.lock")
    with pytest.raises(PermissionDenied, match="can0 can't be locked"):
        DeviceLocks(["can0"], tmp_path / "locks")
    assert (tmp_path / "victim").read_text() == "precious"


def test_a_lock_that_was_taken_away_while_it_was_waited_for_is_taken_anew(tmp_path):
    first = DeviceLocks(["can0"], tmp_path)

    def let_go():
        (tmp_path / "can0.lock").unlink()
        first.release()

    timer = threading.Timer(0.2, let_go)
    timer.start()
    with DeviceLocks(["can0"], tmp_path, wait_s=60.0), pytest.raises(DeviceUnavailable):
        DeviceLocks(["can0"], tmp_path)
    timer.join()


def test_second_daemon_and_an_orphaned_loop(run, tmp_path):
    """The loop of a killed host still moves the outputs: nobody else may, until it has ended too."""
    folder = tmp_path / "locks"
    elsewhere = {"prefix": (sys.executable, "-c", LOCKS_ELSEWHERE, str(folder))}
    text = changed(LEISURELY, *WAITING, BENCH)
    first = run(text, **elsewhere).reach("READY")
    second = run(text, **elsewhere)
    assert second.wait() == 69
    assert second.said == (
        f"micromanip: device bench is in use by another controller (process {first.process.pid}, or the loop that it "
        "left); stop it first\n"
    )
    assert second.report.keys() == {"error", "exit_code"}
    first.go_on(20)
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


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can play another user")
@pytest.mark.parametrize("runs", ["-c", "micromanip.host.loop_process"])
def test_a_strangers_lock_counts_for_root_where_it_may_be_a_controllers(runs):
    """In a folder of everybody's anybody can hold one; its holder may be the child of who took it, and has ended."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o1777)
        DeviceLocks(["board"], folder).release()
        (file,) = folder.iterdir()
        os.chown(file, 4711, -1)
        hold = f"import fcntl,os,time; os.setuid(4711); f=open({str(file)!r}, 'r+'); f.write('1'); f.flush(); "
        hold += "fcntl.flock(f, fcntl.LOCK_EX); print(flush=True); time.sleep(60)"
        with subprocess.Popen([sys.executable, "-c", hold, runs], stdout=subprocess.PIPE) as stranger:
            try:
                stranger.stdout.readline()
                if runs == "-c":
                    with DeviceLocks(["board"], folder), pytest.raises(DeviceUnavailable):
                        DeviceLocks(["board"], folder)
                else:
                    with pytest.raises(DeviceUnavailable, match=rf"\(process {stranger.pid} of user 4711, or"):
                        DeviceLocks(["board"], folder)
            finally:
                stranger.kill()
