"""A slave's end of the mailbox, with its object dictionary: SDOs expedited and normal, abort codes (ETG.1000.6)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

from micromanip.bus.ethercat.coe import (
    ABORT,
    BAD_COMMAND,
    BAD_STATE,
    COE,
    COE_HEADER,
    COMPLETE,
    DOWNLOAD,
    ERROR_TYPE,
    EXPEDITED,
    INFORMATION_ERROR,
    MAILBOX_HEADER,
    NO_OBJECT,
    NO_SUBINDEX,
    NOT_MAPPABLE,
    READ_ONLY,
    SAID_DOWNLOAD,
    SAID_UPLOAD,
    SDO_HEADER,
    SDO_INFORMATION,
    SDO_REQUEST,
    SDO_RESPONSE,
    SIZE_GIVEN,
    UNSUPPORTED,
    UPLOAD,
    WRONG_LENGTH,
)

from .terminal import Entry, Terminal

_PDO_OF_OUTPUTS, _PDO_OF_INPUTS, _PDOS = 0x1600, 0x1A00, 0x200
_SYNC_TYPES, ASSIGNED_OUTPUTS, ASSIGNED_INPUTS = 0x1C00, 0x1C12, 0x1C13


class SdoRefusedError(Exception):
    """An abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08x}")
        self.code = code


class Objects:
    """Read and written by (index, subindex), as bytes. Both raise SdoRefusedError."""

    def __init__(self, terminal: Terminal, may_map: Callable[[], bool]) -> None:
        """`may_map` says whether PDOs may be changed now: in PREOP."""
        self._may_map = may_map
        self._mappable = {e.mapping for pdos in (terminal.outputs, terminal.inputs) for p in pdos.values() for e in p}
        identity = (terminal.vendor, terminal.product, terminal.revision, terminal.serial)
        self._data: dict[int, list[bytes]] = {
            0x1000: [bytes(4)],
            0x1008: [terminal.name.encode()],
            0x1018: _array([struct.pack("<I", number) for number in identity]),
            _SYNC_TYPES: _array([bytes([kind]) for kind in (1, 2, 3, 4)]),
        }
        for assigned, pdos in ((ASSIGNED_OUTPUTS, terminal.outputs), (ASSIGNED_INPUTS, terminal.inputs)):
            self._data[assigned] = _array([struct.pack("<H", index) for index in pdos])
            for index, entries in pdos.items():
                self._data[index] = _array([struct.pack("<I", entry.mapping) for entry in entries])
        self._own: dict[tuple[int, int], bytes] = dict(terminal.settings)

    def read(self, index: int, subindex: int) -> bytes:
        """One entry."""
        if (index, subindex) in self._own:
            return self._own[index, subindex]
        entries = self._data.get(index)
        if entries is None:
            raise SdoRefusedError(NO_SUBINDEX if index in {i for i, _ in self._own} else NO_OBJECT)
        if subindex > len(entries) - 1 or (subindex > entries[0][0] and len(entries) > 1):
            raise SdoRefusedError(NO_SUBINDEX)
        return entries[subindex]

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """One entry."""
        if (index, subindex) in self._own:
            if len(data) != len(self._own[index, subindex]):
                raise SdoRefusedError(WRONG_LENGTH)
            self._own[index, subindex] = data
            return
        width = self._width(index)
        entries = self._data[index]
        if len(data) != (1 if subindex == 0 else width):
            raise SdoRefusedError(WRONG_LENGTH)
        if subindex == 0:
            if data[0] > len(entries) - 1:
                raise SdoRefusedError(NO_SUBINDEX)
            entries[0] = data
            return
        if width == 4 and int.from_bytes(data, "little") not in self._mappable:
            raise SdoRefusedError(NOT_MAPPABLE)
        if subindex > len(entries):
            raise SdoRefusedError(NO_SUBINDEX)
        entries[subindex : subindex + 1] = [data]

    def mapped(self, assigned: int) -> Sequence[Entry]:
        """What the process data of one direction consist of, in their order."""
        mappings = [mapping for index in self._words(assigned, "<H") for mapping in self._words(index, "<I")]
        return [Entry(mapping >> 16, mapping >> 8 & 0xFF, mapping & 0xFF) for mapping in mappings]

    def _words(self, index: int, form: str) -> list[int]:
        entries = self._data.get(index, [b"\0"])
        return [struct.unpack(form, entry)[0] for entry in entries[1 : entries[0][0] + 1]]

    def _width(self, index: int) -> int:
        """Of the entries of an object by which PDOs are made."""
        if index not in self._data:
            raise SdoRefusedError(NO_OBJECT)
        assigns = index in (ASSIGNED_OUTPUTS, ASSIGNED_INPUTS)
        if not assigns and not any(first <= index < first + _PDOS for first in (_PDO_OF_OUTPUTS, _PDO_OF_INPUTS)):
            raise SdoRefusedError(READ_ONLY)
        if not self._may_map():
            raise SdoRefusedError(BAD_STATE)
        return 2 if assigns else 4


def _array(entries: Sequence[bytes]) -> list[bytes]:
    return [bytes([len(entries)]), *entries]


_LONGEST = 16
"""What a normal transfer has before its data: headers of mailbox, CoE and SDO, and its length."""
_UNSUPPORTED, _BAD_HEADER = 2, 8
"""What was wrong with a mail: its protocol, its header."""


class Mailbox:
    """Answers one mail at a time."""

    def __init__(self, objects: Objects, size: int) -> None:
        """`size` is that of each mailbox in bytes."""
        self._objects, self._size = objects, size
        self._counter = 0

    def answer(self, mail: bytes) -> bytes:
        """The answer to a mail of the master."""
        length, _, _, kind = struct.unpack_from(MAILBOX_HEADER, mail)
        body = mail[6 : 6 + length]
        if kind & 0x0F != COE:
            return self._mail(ERROR_TYPE, struct.pack("<HH", 1, _UNSUPPORTED))
        (number,) = struct.unpack_from(COE_HEADER, body.ljust(2, b"\0"))
        if number >> 12 == SDO_INFORMATION:  # its EEPROM says that it has none
            said = struct.pack("<BBHI", INFORMATION_ERROR, 0, 0, UNSUPPORTED)
            return self._mail(COE, struct.pack(COE_HEADER, SDO_INFORMATION << 12) + said)
        if len(body) < length or length < 10:
            return self._mail(ERROR_TYPE, struct.pack("<HH", 1, _BAD_HEADER))
        command, index, subindex = struct.unpack_from(SDO_HEADER, body, 2)
        try:
            said = self._transferred(number >> 12, command, index, subindex, body[6:])
        except SdoRefusedError as refused:
            said = struct.pack("<BHBI", ABORT << 5, index, subindex, refused.code)
            return self._mail(COE, struct.pack(COE_HEADER, SDO_REQUEST << 12) + said)
        return self._mail(COE, struct.pack(COE_HEADER, SDO_RESPONSE << 12) + said)

    def _mail(self, kind: int, body: bytes) -> bytes:
        self._counter = self._counter % 7 + 1
        return (struct.pack(MAILBOX_HEADER, len(body), 0, 0, kind | self._counter << 4) + body).ljust(self._size, b"\0")

    def _transferred(self, service: int, command: int, index: int, subindex: int, data: bytes) -> bytes:
        kind = command >> 5
        if service != SDO_REQUEST or kind not in (UPLOAD, DOWNLOAD):
            raise SdoRefusedError(BAD_COMMAND)
        if command & COMPLETE:
            raise SdoRefusedError(UNSUPPORTED)
        return self._upload(index, subindex) if kind == UPLOAD else self._download(command, index, subindex, data)

    def _upload(self, index: int, subindex: int) -> bytes:
        value, head = self._objects.read(index, subindex), SAID_UPLOAD << 5 | SIZE_GIVEN
        if 1 <= len(value) <= 4:
            head |= EXPEDITED | (4 - len(value)) << 2
            return struct.pack(SDO_HEADER, head, index, subindex) + value.ljust(4, b"\0")
        if len(value) > self._size - _LONGEST:
            raise SdoRefusedError(UNSUPPORTED)
        return struct.pack(SDO_HEADER + "I", head, index, subindex, len(value)) + value

    def _download(self, command: int, index: int, subindex: int, data: bytes) -> bytes:
        if command & EXPEDITED:
            value = data[: 4 - (command >> 2 & 3) if command & SIZE_GIVEN else 4]
        else:
            (length,) = struct.unpack_from("<I", data)
            value = data[4 : 4 + length]
            if len(value) < length:
                raise SdoRefusedError(UNSUPPORTED)
        self._objects.write(index, subindex, value)
        return struct.pack(SDO_HEADER + "I", SAID_DOWNLOAD << 5, index, subindex, 0)
