"""The file of a trip and the folder of all: whole or not at all, damaged ones told, bounded."""

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from micromanip.errors import CheckFailed, PermissionDenied, UsageError
from micromanip.host.trips import process, store
from micromanip.host.trips.store import TripRecord

from .boxes import box


@pytest.mark.parametrize("complete", [False, True])
def test_a_file_brings_everything_back(tmp_path, complete):
    given = replace(box(), meta=box().meta | {"complete": complete})
    given.save(tmp_path / "a.npz")
    read = TripRecord.load(tmp_path / "a.npz")
    assert read.meta == given.meta
    for part in ("rows", "parameters", "state", "events"):
        assert getattr(read, part).dtype == getattr(given, part).dtype
        assert getattr(read, part).tobytes() == getattr(given, part).tobytes()
    assert os.listdir(tmp_path) == ["a.npz"]  # noqa: PTH208


def damaged(folder):
    """Files that are no boxes, each in its own way."""
    good = folder / "good.npz"
    box().save(good)
    content = good.read_bytes()
    middle = len(content) // 2
    yield "empty", b""
    yield "text", b"schema_version: 2\n"
    yield "cut", content[:middle]
    yield (
        "flipped",
        content[:middle] + bytes(byte ^ 0xFF for byte in content[middle : middle + 4000]) + content[middle + 4000 :],
    )
    other = folder / "other.npz"
    np.savez(other, meta=np.array(json.dumps({"format": 1})))
    yield "lacking", other.read_bytes()
    np.savez(other, meta=np.array("not JSON"))
    yield "no JSON", other.read_bytes()
    np.savez(other, meta=np.array(json.dumps({"format": 99})))
    yield "newer", other.read_bytes()
    np.savez(other, meta=np.array([{"format": 1}], dtype=object))
    yield "pickled", other.read_bytes()
    np.save(folder / "plain.npy", np.zeros(3))
    yield "plain array", (folder / "plain.npy").read_bytes()


def test_damaged_files_are_told_in_one_sentence(tmp_path):
    for what, content in list(damaged(tmp_path)):
        file = tmp_path / "bad.npz"
        file.write_bytes(content)
        with pytest.raises(CheckFailed) as caught:
            TripRecord.load(file)
        assert str(caught.value).startswith(str(file)), what
        assert "\n" not in str(caught.value), what
    with pytest.raises(CheckFailed, match="can't be read: No such file"):
        TripRecord.load(tmp_path / "none.npz")


def names_of(count):
    return [store.file_name(10**18 + k * 10**9, "X-201", "x") for k in range(count)]


def test_the_newest_are_kept_and_nothing_foreign_is_touched(tmp_path):
    for name in [*names_of(6), "notes.txt", "mine.npz", ".x.npz.123.part", ".y.npz.124.part"]:
        (tmp_path / name).touch()
    os.utime(tmp_path / ".x.npz.123.part", (0, 0))  # of a writer that died long ago
    store.prune(tmp_path, 4)
    left = {entry.name for entry in tmp_path.iterdir()}
    assert left == {*names_of(6)[2:], "notes.txt", "mine.npz", ".y.npz.124.part"}


def test_finding_one(tmp_path):
    names = names_of(3)
    for name in names:
        (tmp_path / name).touch()
    assert store.find(tmp_path, None).name == names[-1]
    assert store.find(tmp_path, names[1]).name == names[1]
    assert store.find(tmp_path, names[1][:19]).name == names[1]
    assert store.find(Path("/nowhere"), str(tmp_path / names[0])).name == names[0]
    with pytest.raises(UsageError, match=r"3 trips in .* begin with 2001"):
        store.find(tmp_path, "2001")
    with pytest.raises(UsageError, match="there is no trip 1999"):
        store.find(tmp_path, "1999")
    with pytest.raises(UsageError, match="there are no trips in"):
        store.find(tmp_path / "none", None)


def test_trips_of_the_service_are_read_first(monkeypatch, tmp_path):
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "own"))
    assert store.folder_to_read(tmp_path / "system") == tmp_path / "own" / "micromanip" / "trips"
    (tmp_path / "system").mkdir()
    assert store.folder_to_read(tmp_path / "system") == tmp_path / "system"
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/other")
    assert store.folder_to_read(tmp_path / "system") == Path("/var/lib/other/trips")


def test_a_folder_that_may_not_be_read(monkeypatch, tmp_path):
    def forbidden(_folder):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", forbidden)
    with pytest.raises(PermissionDenied, match="your user must be in the controller's group"):
        store.trips(tmp_path)


def test_what_finds_no_room_is_kept_and_tried_again(tmp_path, capfd):
    blocked = tmp_path / "state"
    blocked.touch()
    kept = store.TripArchive(blocked / "trips", 50, process.send_message)
    for key in range(6):
        kept.put(replace(box(), meta=box().meta | {"utc_ns": 10**18 + key * 10**9}), key)
    said = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    assert [m["key"] for m in said if "problem" in m] == list(range(6))
    assert [m["key"] for m in said if "lost" in m] == [0, 1]  # memory is bounded: the newest four stay
    kept.retry()
    assert capfd.readouterr().out == ""  # not yet
    blocked.unlink()
    kept.give_up()
    said = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    assert [(m["key"], m["complete"]) for m in said] == [(key, True) for key in range(2, 6)]
    assert [file.name for file in store.trips(blocked / "trips")] == names_of(6)[2:]


class EndsWhileABoxIsSaved:
    """A capture whose loop latches a second fault and ends while the box of the first is completed."""

    trips, cycles, finished = 1, 100, False

    def tripped(self):
        code = ("X-201", "X-101")[self.trips - 1]
        return replace(box(code=code), meta=box(code=code).meta | {"complete": False, "utc_ns": 10**18 * self.trips})

    def is_over(self, _box):
        return True

    def completed(self, given):
        self.trips, self.finished = 2, True
        return replace(given, meta=given.meta | {"complete": True})


def test_a_fault_that_ends_the_run_while_a_box_is_saved(tmp_path, capfd):
    watch = process.Watch(EndsWhileABoxIsSaved(), store.TripArchive(tmp_path, 50, process.send_message), 0, 1.0)
    while not watch.over:
        watch.look(host_lives=False)
    assert [TripRecord.load(file).trip["code"] for file in store.trips(tmp_path)] == ["X-201", "X-101"]
    assert [json.loads(line)["key"] for line in capfd.readouterr().out.splitlines()] == [1, 1, 2, 2]
