"""The audit trail: every entry once, bounded, and in nobody's way when the disk is not there."""

import asyncio
import json
import os
import socket
from datetime import UTC, date, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.host.control.audit import AuditFiles, AuditTrail, Keeping, Repeats
from micromanip.host.control.authority import Peer
from micromanip.replies import Change

ALICE = Peer("alice", 1000, 42)


@pytest.fixture
def said():
    return []


@pytest.fixture
def trail(tmp_path, said):
    return AuditTrail(tmp_path / "state" / "micromanip", said.append)


def note(trail, *arguments, **more):
    asyncio.run(trail.note(*arguments, **more))


def test_entry(trail, said):
    note(trail, ALICE, "set", [{"key": "axes.x.inner.K_V_per_um", "old": 0.6, "new": 0.5}])
    note(trail, Peer("configuration"), "arm", reason="arm refused: the state is FAULT")
    first, second = map(json.loads, trail.file.read_text().splitlines())
    assert trail.last(20) == {"file": str(trail.file), "unwritten": 0, "entries": [first, second]}
    assert first.pop("time").endswith("Z")
    assert first == {
        "user": "alice",
        "uid": 1000,
        "pid": 42,
        "verb": "set",
        "accepted": True,
        "reason": None,
        "changes": [{"key": "axes.x.inner.K_V_per_um", "old": 0.6, "new": 0.5}],
        "missing_before": 0,
    }
    assert (second["user"], second["pid"], second["accepted"]) == ("configuration", None, False)
    assert second["reason"] == "arm refused: the state is FAULT"
    assert trail.last(1)["entries"] == [second]
    assert said == []
    assert trail.file.stat().st_mode & 0o777 == 0o640


def test_impossible_place(tmp_path, said):
    """Once a warning; every entry is counted, and the count is told when there is room again."""
    (tmp_path / "file").touch()
    trail = AuditTrail(tmp_path / "file" / "deeper", said.append)
    for _ in range(3):
        note(trail, ALICE, "arm")
    assert trail.unwritten == 3
    assert said == [f"WARNING: the audit trail {trail.file} can't be written: Not a directory. What is not is counted."]
    (tmp_path / "file").unlink()
    note(trail, ALICE, "disarm")
    note(trail, ALICE, "arm")
    assert [(e["verb"], e["missing_before"]) for e in trail.last(9)["entries"]] == [("disarm", 3), ("arm", 0)]
    assert trail.last(9)["unwritten"] == 3


def test_full_disk(trail, said, monkeypatch):
    """Half a line that a full disk left does not spoil the next one."""
    write = os.write
    monkeypatch.setattr(os, "write", lambda descriptor, content: write(descriptor, content[:30]))
    note(trail, ALICE, "arm")
    monkeypatch.undo()
    note(trail, ALICE, "disarm")
    assert [(e["verb"], e["missing_before"]) for e in trail.last(9)["entries"]] == [("disarm", 1)]
    assert len(said) == 1
    assert "the disk is full" in said[0]


def test_peer_is_told_by_the_kernel():
    ours, theirs = socket.socketpair(socket.AF_UNIX)
    with ours, theirs:
        peer = Peer.of(ours)
    assert (peer.uid, peer.pid) == (os.geteuid(), os.getpid())
    assert peer.user
    assert peer.groups == {os.getegid(), *os.getgroups()}


def test_huge_values_do_not_push_out_what_was_there(trail):
    """Five hundred refusals, each of another 60 kB: who armed stays on the first page, and the trail stays small."""
    note(trail, ALICE, "arm")

    async def flood():
        for k in range(500):
            changes = {"axes.x.mode": f"{k}" + "x" * 60_000, **{f"{k}.{j}": j for j in range(100)}}
            asked = [Change(key=key, old=None, new=value) for key, value in changes.items()]
            await trail.note(ALICE, "set", asked, "refused: the state is FAULT")
            await trail.note(ALICE, "set", reason=f"{k} " + "y" * 60_000)
        await trail.close()

    asyncio.run(flood())
    assert sum(file.stat().st_size for file in trail.file.parent.iterdir()) < 200_000
    entries = trail.last(1000)["entries"]
    assert entries[0]["verb"] == "arm"
    refused = entries[1]
    assert refused["changes"][0]["new"] == "0" + "x" * 99 + "... (cut off, 60001 characters)"
    assert refused["changes"][-1]["key"] == "(and 81 more)"
    assert entries[2]["reason"].endswith("... (cut off, 60002 characters)")
    told = [entry for entry in entries[1:] if "repeated" not in entry]
    assert len(told) + sum(entry.get("repeated", 0) for entry in entries) == 1000


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 30)), max_size=300))
def test_every_refusal_is_written_or_counted(refused):
    """Whatever users refuse and whenever: written and counted add up, and no user has more lines than allowed."""
    clock = [0.0]
    repeats = Repeats(window_s=10, distinct=3, clock=lambda: clock[0])
    written, counted = {}, 0
    for user, reason in refused:
        clock[0] += 0.01
        if not repeats.is_counted({"user": f"{user}", "uid": user, "verb": "arm", "reason": f"{reason}"}):
            written[user] = written.get(user, 0) + 1
    counted = sum(entry["repeated"] for entry in repeats.over(now=True))
    assert sum(written.values()) + counted == len(refused)
    assert all(count <= 3 for count in written.values())


def written_on(files, day, lines, size=100):
    """`lines` lines written on `day`."""
    for k in range(lines):
        files._now = lambda: datetime(day.year, day.month, day.day, 12, tzinfo=UTC)
        files.append(f"{day} {k:04d} ".ljust(size - 1, "x"))
        os.utime(files.file, (files._now().timestamp(),) * 2)


def days_of(files):
    return {line[:10] for file in files.newest_first() if file.exists() for line in file.read_text().splitlines()}


def test_a_burst_pushes_out_itself(tmp_path):
    """A day with a hundred times what may be kept: the days before are all there, and so is its own end."""
    files = AuditFiles(tmp_path, Keeping(most_bytes=12_000, part_bytes=1_000))
    for k in range(30):
        written_on(files, date(2026, 3, 1) + timedelta(days=k), 3)
    written_on(files, date(2026, 4, 1), 1_000)
    written_on(files, date(2026, 4, 2), 3)
    assert len(days_of(files)) == 32
    assert sum(file.stat().st_size for file in tmp_path.iterdir()) <= 12_000
    assert "2026-04-01 0999" in next(f for f in files.newest_first() if "04-01" in f.name).read_text()


def test_each_line_is_on_the_disk(trail, monkeypatch):
    synchronised = []
    monkeypatch.setattr(os, "fsync", synchronised.append)
    note(trail, ALICE, "arm")
    assert len(synchronised) == 2  # the file, and the folder that it is new in
    note(trail, ALICE, "disarm")
    assert len(synchronised) == 3


def test_a_planted_link_is_not_written_through(trail, tmp_path, said):
    trail.file.parent.mkdir(parents=True)
    (tmp_path / "precious").write_text("precious")
    trail.file.symlink_to(tmp_path / "precious")
    note(trail, ALICE, "arm")
    assert (tmp_path / "precious").read_text() == "precious"
    assert trail.unwritten == 1
