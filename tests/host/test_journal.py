"""Structured entries for the journal, read from a real datagram socket in its place."""

import os
import socket

import pytest

from micromanip.host import journal


def test_a_fault_has_its_code_and_axis_as_fields(tmp_path):
    path = tmp_path / "journal"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(path))
        listener.settimeout(5)
        assert journal.send("X-201 axis y: no usable strain-gauge sample for 3 cycles.\nCheck the gauge.", path)
        assert listener.recv(4096).decode().splitlines() == [
            "MESSAGE=X-201 axis y: no usable strain-gauge sample for 3 cycles. Check the gauge.",
            "PRIORITY=3",
            "SYSLOG_IDENTIFIER=micromanip",
            "MICROMANIP_CODE=X-201",
            "MICROMANIP_AXIS=y",
        ]


@pytest.mark.parametrize(
    ("message", "priority", "code"),
    [
        ("READY", "6", None),
        ("WARNING: no FIFO", "4", None),
        ("X-104 the loop process ended with 1", "3", "X-104"),
    ],
)
def test_priority(message, priority, code):
    entry = journal.fields(message)
    assert entry["PRIORITY"] == priority
    assert entry.get("MICROMANIP_CODE") == code
    assert "MICROMANIP_AXIS" not in entry


def test_no_journal_is_said(tmp_path):
    assert not journal.send("READY", tmp_path / "none")


def test_only_the_stream_that_the_service_manager_gave_leads_there():
    read, write = os.pipe()
    try:
        found = os.fstat(write)
        stream = {"JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"}
        assert journal.leads_to_journal(write, stream)
        assert not journal.leads_to_journal(write, {})
        assert not journal.leads_to_journal(1, stream)  # redirected
    finally:
        os.close(read)
        os.close(write)
    assert not journal.leads_to_journal(write, stream)
