"""Structured entries of the journal, received by a datagram socket of our own."""

import os
import socket
import struct

import pytest

from micromanip.faults import BY_NAME, FaultReport
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
    report = FaultReport(BY_NAME["FOLLOWING_ERROR"], "x", 6.1, 5.0, cycle=7, box="/trips/a.npz")
    assert journal.send(journal.fields(report), path)
    assert parsed(taken.recv(65536)) == {
        "MESSAGE": str(report),
        "PRIORITY": "2",
        "MESSAGE_ID": journal.TRIP,
        "SYSLOG_IDENTIFIER": "micromanip",
        "MICROMANIP_CODE": "X-213",
        "MICROMANIP_AXIS": "x",
        "MICROMANIP_VALUE": "6.1",
        "MICROMANIP_LIMIT": "5",
        "MICROMANIP_TRIP": "/trips/a.npz",
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


def test_a_warning_of_the_loop_is_no_trip():
    fields = journal.fields(FaultReport(BY_NAME["SATURATING"], "z", 150.0, 500.0))
    assert (fields["PRIORITY"], fields["MICROMANIP_CODE"], fields["MICROMANIP_AXIS"]) == ("4", "W-214", "z")
    assert "MESSAGE_ID" not in fields
