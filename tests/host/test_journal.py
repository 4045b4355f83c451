"""Structured entries of the journal, received by a datagram socket of our own."""

import os
import socket
import struct

import pytest

from micromanip.host import journal


@pytest.fixture
def receiver(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as taken:
        taken.bind(str(tmp_path / "journal"))
        taken.settimeout(5.0)
        yield taken, tmp_path / "journal"


def parsed(datagram):
    """The fields of an entry, read as the journal's documentation of its native protocol says."""
    fields = {}
    while datagram:
        line, _, rest = datagram.partition(b"\n")
        if b"=" in line:
            name, _, value = line.partition(b"=")
        else:
            name, (length,) = line, struct.unpack("<Q", rest[:8])
            value, rest = rest[8 : 8 + length], rest[9 + length :]
        fields[name.decode()] = value.decode()
        datagram = rest
    return fields


def test_a_trip_arrives_with_its_fields(receiver):
    taken, path = receiver
    fields = journal.trip_fields("X-210 axis x: 6.1 um > 5 um", "X-210", "x", 6.1, 5.0, "/trips/a.npz")
    assert journal.send(fields, path)
    assert parsed(taken.recv(65536)) == {
        "MESSAGE": "X-210 axis x: 6.1 um > 5 um",
        "PRIORITY": "2",
        "MESSAGE_ID": journal.TRIP,
        "SYSLOG_IDENTIFIER": "micromanip",
        "MICROMANIP_CODE": "X-210",
        "MICROMANIP_AXIS": "x",
        "MICROMANIP_VALUE": "6.1",
        "MICROMANIP_LIMIT": "5",
        "MICROMANIP_TRIP": "/trips/a.npz",
    }


def test_what_is_not_known_is_left_out(receiver):
    taken, path = receiver
    assert journal.send(journal.trip_fields("dead", "X-104", None, None, float("nan"), None), path)
    assert set(parsed(taken.recv(65536))) == {
        "MESSAGE",
        "PRIORITY",
        "MESSAGE_ID",
        "SYSLOG_IDENTIFIER",
        "MICROMANIP_CODE",
    }


def test_a_value_of_several_lines_stays_one_field(receiver):
    taken, path = receiver
    assert journal.send({"MESSAGE": "one\nMICROMANIP_CODE=forged", "PRIORITY": "2"}, path)
    assert parsed(taken.recv(65536)) == {"MESSAGE": "one\nMICROMANIP_CODE=forged", "PRIORITY": "2"}


def test_nobody_there_and_nobody_reading(receiver, tmp_path):
    _, path = receiver
    assert not journal.send({"MESSAGE": "x"}, tmp_path / "nobody")
    sent = 0
    while journal.send({"MESSAGE": "x" * 1000}, path):  # never read: full some day, and then it does not block
        sent += 1
        assert sent < 100_000


def test_it_is_used_only_where_standard_error_is_the_journal(monkeypatch):
    found = os.fstat(2)
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    assert not journal.is_connected()
    monkeypatch.setenv("JOURNAL_STREAM", f"{found.st_dev}:{found.st_ino}")
    assert journal.is_connected()
    for other in (f"{found.st_dev}:{found.st_ino + 1}", "nonsense", ""):
        monkeypatch.setenv("JOURNAL_STREAM", other)
        assert not journal.is_connected()


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("READY", {"PRIORITY": "6"}),
        ("WARNING: no FIFO", {"PRIORITY": "4"}),
        ("X-104 the loop process ended with 1", {"PRIORITY": "3", "MICROMANIP_CODE": "X-104"}),
        ("X-201 axis y: gone", {"PRIORITY": "3", "MICROMANIP_CODE": "X-201", "MICROMANIP_AXIS": "y"}),
        ("W-214 axis z: at its end", {"PRIORITY": "4", "MICROMANIP_CODE": "W-214", "MICROMANIP_AXIS": "z"}),
    ],
)
def test_a_plain_message_has_its_priority(message, expected):
    common = {"MESSAGE": message, "SYSLOG_IDENTIFIER": "micromanip"}
    assert journal.message_fields(message) == common | expected
