"""What a device was given last: it outlives whoever wrote it, and nobody else can say it."""

import os
import signal
import struct
import time

import pytest

from micromanip.bus import last_given
from micromanip.bus.last_given import LastGiven
from micromanip.errors import PermissionDenied

DEVICE = "udp 10.0.0.5:5005"
NAMES = ("voltage_x", "voltage_y")


def file_in(folder):
    return folder / "udp_10.0.0.5_5005.given"


def reopened(folder, names=NAMES):
    return LastGiven.open(DEVICE, names, folder).read()


def test_a_writer_that_was_killed_leaves_whole_values(tmp_path):
    begun, begins = os.pipe()
    child = os.fork()
    if not child:
        given, k = LastGiven.open(DEVICE, NAMES, tmp_path), 0.0
        while True:
            k += 1.0
            given.write([k, -k])
            if k == 1.0:
                os.write(begins, b"\0")
    os.read(begun, 1)
    time.sleep(0.1)
    for end in (begun, begins):
        os.close(end)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    x, y = reopened(tmp_path)
    assert x == -y > 0.0


def test_a_slot_that_was_half_written_does_not_count(tmp_path):
    given = LastGiven.open(DEVICE, NAMES, tmp_path)
    given.write([1.0, 2.0])
    given.write([3.0, 4.0])
    whole = file_in(tmp_path).read_bytes()
    newest = int(given.record[0]["place"][given.record[0]["turn"][0] % 2])
    file_in(tmp_path).write_bytes(whole[:newest] + (99).to_bytes(8, "little") + whole[newest + 8 :])
    assert reopened(tmp_path) == [1.0, 2.0]


def test_outputs_keep_their_values_where_the_configuration_has_others(tmp_path):
    LastGiven.open(DEVICE, NAMES, tmp_path).write([80.0, 20.0])
    assert reopened(tmp_path, ("voltage_z", "voltage_x")) == [None, 80.0]


def test_an_earlier_start_of_the_machine_does_not_count(tmp_path, monkeypatch):
    for start in ("one", "another", "", ""):  # one that is not known is never the same
        monkeypatch.setattr(last_given, "_start", lambda _, start=start: start)
        assert reopened(tmp_path) is None
        LastGiven.open(DEVICE, NAMES, tmp_path).write([80.0, 20.0])


@pytest.mark.parametrize("content", [b"", b"\0" * 40000, b"[1, 2]", b'{"names": 3}', b'{"names": ["voltage_x"]}'])
def test_a_file_that_is_damaged_is_replaced(tmp_path, content):
    file_in(tmp_path).write_bytes(content)
    assert reopened(tmp_path) is None


def test_a_link_is_not_followed_and_nothing_is_written_through_it(tmp_path):
    LastGiven.open(DEVICE, NAMES, tmp_path / ".").write([80.0, 20.0])
    elsewhere = tmp_path / "elsewhere"
    file_in(tmp_path).rename(elsewhere)
    before = elsewhere.read_bytes()
    file_in(tmp_path).symlink_to(elsewhere)
    given = LastGiven.open(DEVICE, NAMES, tmp_path)
    assert given.read() is None
    given.write([1.0, 2.0])
    assert elsewhere.read_bytes() == before


def test_a_pipe_in_its_place_hangs_nobody(tmp_path):
    os.mkfifo(file_in(tmp_path))
    assert reopened(tmp_path) is None


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to somebody else")
@pytest.mark.parametrize(("mode", "believed"), [(0o1777, False), (0o2770, True)])
def test_what_somebody_else_wrote_counts_only_in_a_folder_of_a_group(tmp_path, mode, believed):
    folder = tmp_path / "locks"
    folder.mkdir()
    folder.chmod(mode)
    LastGiven.open(DEVICE, NAMES, folder).write([80.0, 20.0])
    os.chown(file_in(folder), 1234, -1)
    assert reopened(folder) == ([80.0, 20.0] if believed else None)


def test_a_folder_that_is_not_there_is_one_clear_refusal(tmp_path):
    with pytest.raises(PermissionDenied, match=r"what device udp .* can't be remembered in .*No such file"):
        LastGiven.open(DEVICE, NAMES, tmp_path / "nowhere")


def test_it_is_the_device_s_and_not_the_name_s(tmp_path):
    (tmp_path / "by-id").symlink_to("tty0")
    names = ("tcp localhost:502", "tcp 127.0.0.1:502"), (str(tmp_path / "by-id"), str(tmp_path / "tty0"))
    for first, second in names:
        memory = LastGiven.open(first, ["x"], tmp_path)
        memory.write([80.0])
        memory.close()
        assert LastGiven.open(second, ["x"], tmp_path).read() == [80.0]


def test_a_device_that_comes_back_under_another_path_takes_it_along(tmp_path):
    link = tmp_path / "by-id"
    link.symlink_to("tty0")
    memory = LastGiven.open(str(link), ["x"], tmp_path)
    memory.write([80.0])
    LastGiven.open(str(tmp_path / "tty1"), ["x"], tmp_path).write([10.0])  # of what was plugged in there before
    link.unlink()
    link.symlink_to("tty1")
    moved = memory.follow(str(link), ["x"], [80.0])
    assert LastGiven.open(str(link), ["x"], tmp_path).read() == [80.0], "before anything more was given"
    moved.write([70.0])
    assert LastGiven.open(str(tmp_path / "tty1"), ["x"], tmp_path).read() == [70.0]


@pytest.mark.parametrize("known", [None, [80.0]])
def test_the_number_of_a_pseudo_terminal_is_given_again_and_what_was_remembered_of_it_is_not(known, tmp_path):
    master, slave = os.openpty()
    name = os.ttyname(slave)
    memory, others = LastGiven.open(name, ["x"], tmp_path), []
    memory.write([80.0])
    os.write(slave, b"to the device")
    assert memory.follow(name, ["x"], [80.0]) is memory
    os.close(slave)
    os.close(master)
    try:
        while not others or os.ttyname(others[-1]) != name:
            assert len(others) < 100
            others += os.openpty()
        if known:
            memory.follow(name, ["x"], known)
        assert LastGiven.open(name, ["x"], tmp_path).read() == known
    finally:
        for descriptor in others:
            os.close(descriptor)


def test_values_that_nobody_wrote_count_as_nothing(tmp_path):
    """Both slots, changed to a value that any output might have had: nobody knows what the device has."""
    given = LastGiven.open(DEVICE, NAMES, tmp_path)
    for _ in range(2):
        given.write([46.0, 20.0])
    whole = file_in(tmp_path).read_bytes()
    file_in(tmp_path).write_bytes(whole.replace(struct.pack("<d", 46.0), struct.pack("<d", 0.0)))
    assert reopened(tmp_path) is None


def test_what_was_written_for_another_device_or_start_counts_as_nothing(tmp_path):
    LastGiven.open(DEVICE, NAMES, tmp_path).write([46.0, 20.0])
    other = LastGiven.open("udp 10.0.0.6:5005", NAMES, tmp_path)
    (file,) = tmp_path.glob("*10.0.0.6*")
    mine, slots = file_in(tmp_path).read_bytes(), 2 * 8 * (2 + len(NAMES))
    file.write_bytes(file.read_bytes()[:-slots] + mine[-slots:])
    assert LastGiven.open("udp 10.0.0.6:5005", NAMES, tmp_path).read() is None
    assert other.read() is None


@pytest.mark.parametrize("left", [0, 10, 20_000])
def test_a_file_that_is_cut_short_ends_nobody_and_counts_as_nothing(tmp_path, left):
    given = LastGiven.open(DEVICE, NAMES, tmp_path)
    given.write([46.0, 20.0])
    os.truncate(file_in(tmp_path), left)
    given.write([47.0, 20.0])
    assert reopened(tmp_path) is None
