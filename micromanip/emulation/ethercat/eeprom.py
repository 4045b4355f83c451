"""The EEPROM of a slave (SII, ETG.2010): identity, mailboxes, and what is in its categories."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence

from .terminal import MAILBOX_BYTES, MAILBOX_IN, MAILBOX_OUT, Entry, Terminal

_STRINGS, _GENERAL, _FMMU, _SYNC, _TX_PDO, _RX_PDO, _END = 10, 30, 40, 41, 50, 51, 0xFFFF
_COE = 0x04
_COE_DETAILS = 0x01 | 0x04
"""SDO, PDO assignment."""
_BYTES = 2048
_CONTROL_TO, _CONTROL_FROM = 0x26, 0x22
"""Of the sync managers of the mailboxes to and from the slave."""
_TO, _FROM, _OUTPUTS, _INPUTS = 1, 2, 3, 4
"""Kinds of sync managers."""
_BOOLEAN = 1
"""Type of an entry that is a bit; others are not told."""


def eeprom_of(terminal: Terminal) -> bytes:
    """Its contents, 2 KiB."""
    head = bytearray(128)
    struct.pack_into("<HH", head, 0, 0x0004, 0)
    head[14] = _crc(bytes(head[:14]))
    struct.pack_into("<4I", head, 16, terminal.vendor, terminal.product, terminal.revision, terminal.serial)
    if not terminal.is_digital:
        mailboxes = (MAILBOX_OUT, MAILBOX_BYTES, MAILBOX_IN, MAILBOX_BYTES, _COE)
        struct.pack_into("<5H", head, 48, *mailboxes)
    struct.pack_into("<HH", head, 124, _BYTES * 8 // 1024 - 1, 1)
    body = b"".join(struct.pack("<HH", kind, len(data) // 2) + data for kind, data in _categories(terminal))
    whole = bytes(head) + body + struct.pack("<H", _END)
    return whole.ljust(_BYTES, b"\xff")


def _categories(terminal: Terminal) -> Iterator[tuple[int, bytes]]:
    names = [terminal.name, *(entry.name for pdos in _pdos(terminal) for part in pdos.values() for entry in part)]
    strings = bytes([len(names)]) + b"".join(bytes([len(name)]) + name.encode() for name in names)
    yield _STRINGS, _even(strings)
    general = bytearray(32)
    general[0], general[2], general[3], general[5] = 1, 1, 1, 0 if terminal.is_digital else _COE_DETAILS
    yield _GENERAL, bytes(general)
    yield _FMMU, bytes([1, 2, 3, 0])
    process_data = (
        (terminal.output_area, terminal.output_bytes, _OUTPUTS),
        (terminal.input_area, terminal.input_bytes, _INPUTS),
    )
    managers = [
        (area.start, size, area.control, int(size > 0), kind)
        for area, size, kind in process_data
        if size or not terminal.is_digital
    ]
    if not terminal.is_digital:
        managers = [
            (MAILBOX_OUT, MAILBOX_BYTES, _CONTROL_TO, 1, _TO),
            (MAILBOX_IN, MAILBOX_BYTES, _CONTROL_FROM, 1, _FROM),
            *managers,
        ]
    yield (
        _SYNC,
        b"".join(struct.pack("<HHBBBB", at, size, control, 0, on, kind) for at, size, control, on, kind in managers),
    )
    string = 2
    for category, manager, pdos in (
        (_RX_PDO, terminal.output_area.manager, terminal.outputs),
        (_TX_PDO, terminal.input_area.manager, terminal.inputs),
    ):
        data = b""
        for index, entries in pdos.items():
            data += struct.pack("<HBBBBH", index, len(entries), manager, 0, 0, 0)
            for entry in entries:
                kind = _BOOLEAN if entry.bits == 1 else 0
                data += struct.pack("<HBBBBH", entry.index, entry.subindex, string, kind, entry.bits, 0)
                string += 1
        if data:
            yield category, data


def _pdos(terminal: Terminal) -> tuple[Mapping[int, Sequence[Entry]], Mapping[int, Sequence[Entry]]]:
    return terminal.outputs, terminal.inputs


def _even(data: bytes) -> bytes:
    return data + bytes(len(data) % 2)


def _crc(data: bytes) -> int:
    """CRC-8, polynomial 0x07, begun with 0xFF."""
    register = 0xFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register << 1) ^ (0x07 if register & 0x80 else 0)
            register &= 0xFF
    return register
