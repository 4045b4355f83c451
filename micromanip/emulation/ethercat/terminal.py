"""What kind of slave it is: its identity, what its PDOs map, its other objects; its EEPROM (SII, ETG.2010)."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from micromanip.bus.ethercat.process_data import bytes_of

MAILBOX_BYTES = 128
MAILBOX_OUT, MAILBOX_IN, OUTPUTS, INPUTS = 0x1000, 0x1080, 0x1100, 0x1800
"""Where mailboxes and process data lie in the memory of an emulated slave."""
DIGITAL_OUTPUTS, DIGITAL_INPUTS = 0x0F00, 0x1000
"""Where the process data of one without a processor lie: the register of its pins, and the first of its memory."""


@dataclass(frozen=True)
class Area:
    """Process data of one direction: which sync manager they have, where they begin, its control byte."""

    manager: int
    start: int
    control: int


@dataclass(frozen=True)
class Entry:
    """An object in a PDO; index 0 for a gap."""

    index: int
    subindex: int
    bits: int
    name: str = ""

    @property
    def mapping(self) -> int:
        """As objects 0x1600.. and 0x1A00.. hold it."""
        return self.index << 16 | self.subindex << 8 | self.bits


@dataclass(frozen=True)
class Terminal:
    """A slave: `outputs` and `inputs` are its PDOs (0x1600.., 0x1A00..) with what they map.

    `settings` are objects of its own, (index, subindex) to bytes, that a master may write.
    One that `is_digital` has no processor: no mailbox, its pins are bits of the controller itself.
    """

    name: str
    vendor: int
    product: int
    revision: int
    serial: int
    outputs: Mapping[int, Sequence[Entry]] = field(default_factory=dict)
    inputs: Mapping[int, Sequence[Entry]] = field(default_factory=dict)
    settings: Mapping[tuple[int, int], bytes] = field(default_factory=dict)
    is_digital: bool = False

    @property
    def output_area(self) -> Area:
        """Of its outputs."""
        return Area(0, DIGITAL_OUTPUTS, 0x44) if self.is_digital else Area(2, OUTPUTS, 0x64)

    @property
    def input_area(self) -> Area:
        """Of its inputs."""
        if self.is_digital:
            return Area(int(self.output_bytes > 0), DIGITAL_INPUTS, 0x00)
        return Area(3, INPUTS, 0x20)

    @property
    def output_bytes(self) -> int:
        """Length of its outputs."""
        return _bytes(self.outputs)

    @property
    def input_bytes(self) -> int:
        """Length of its inputs."""
        return _bytes(self.inputs)


def _bytes(pdos: Mapping[int, Sequence[Entry]]) -> int:
    return bytes_of(entry.bits for entries in pdos.values() for entry in entries)


def terminal_of(name: str, keys: Any) -> Terminal:
    """The slave that the configuration expects; revision and serial number are 1 where it says nothing."""
    outputs, inputs = ({pdo.pdo: _entries(pdo) for pdo in pdos.values()} for pdos in (keys.outputs, keys.inputs))
    settings = {(each.index, each.subindex): bytes(each.size) for each in keys.settings.values()}
    revision = 1 if keys.revision is None else keys.revision
    serial = 1 if keys.serial is None else keys.serial
    is_digital = not settings and _are_bits(outputs | inputs)
    return Terminal(name, keys.vendor, keys.product, revision, serial, outputs, inputs, settings, is_digital)


def _entries(pdo: Any) -> list[Entry]:
    return [Entry(field.index, field.subindex, field.bits, name) for name, field in pdo.fields.items()]


def _are_bits(pdos: Mapping[int, Sequence[Entry]]) -> bool:
    return bool(pdos) and all(entry.bits == 1 for entries in pdos.values() for entry in entries)


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
    pdos_of_all = (*terminal.outputs.values(), *terminal.inputs.values())
    names = [terminal.name, *(entry.name for entries in pdos_of_all for entry in entries)]
    strings = bytes([len(names)]) + b"".join(bytes([len(name)]) + name.encode() for name in names)
    yield _STRINGS, strings + bytes(len(strings) % 2)
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


def _crc(data: bytes) -> int:
    """CRC-8, polynomial 0x07, begun with 0xFF."""
    register = 0xFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register << 1) ^ (0x07 if register & 0x80 else 0)
            register &= 0xFF
    return register
