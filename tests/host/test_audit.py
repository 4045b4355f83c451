"""The audit trail: every entry once, bounded, and in nobody's way when the disk is not there."""

import asyncio
import json
import os
import socket

import pytest

from micromanip.host.audit import AuditTrail
from micromanip.host.peer import Peer
from micromanip.host.state_directory import state_directory

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


def test_two_files_at_most(trail, tmp_path):
    small = AuditTrail(tmp_path, print, max_bytes=1000)
    for k in range(50):
        note(small, ALICE, f"verb{k}")
    files = sorted(path.name for path in tmp_path.glob("audit*"))
    assert files == ["audit.jsonl", "audit.jsonl.1"]
    assert all((tmp_path / name).stat().st_size < 1300 for name in files)
    verbs = [entry["verb"] for entry in small.last(1000)["entries"]]
    assert verbs == [f"verb{k}" for k in range(50 - len(verbs), 50)]
    assert len(verbs) >= 6


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


def test_what_is_not_an_entry_is_passed_over(trail):
    trail.file.parent.mkdir(parents=True)
    trail.file.write_bytes(b'nonsense\n[1]\n{"verb": "arm"}\n\xff\xfe\n')
    note(trail, ALICE, "arm")
    assert [entry["user"] for entry in trail.last(9)["entries"]] == ["alice"]


def test_peer_is_told_by_the_kernel():
    ours, theirs = socket.socketpair(socket.AF_UNIX)
    with ours, theirs:
        peer = Peer.of(ours)
    assert (peer.uid, peer.pid) == (os.geteuid(), os.getpid())
    assert peer.user


def test_place(monkeypatch, tmp_path):
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/micromanip:/var/lib/other")
    assert str(state_directory()) == "/var/lib/micromanip"
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_directory() == tmp_path / "micromanip"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_directory() == tmp_path / ".local" / "state" / "micromanip"
