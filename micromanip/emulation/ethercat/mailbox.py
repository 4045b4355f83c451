"""A slave's end of the mailbox: SDOs expedited, normal and in segments, complete access, abort codes (ETG.1000.6)."""

from __future__ import annotations

import struct

from micromanip.bus.ethercat.coe import (
    ABORT,
    BAD_COMMAND,
    COE,
    COE_HEADER,
    COMPLETE,
    DOWNLOAD,
    DOWNLOAD_SEGMENT,
    ERROR_TYPE,
    EXPEDITED,
    INFORMATION_ERROR,
    LAST_SEGMENT,
    MAILBOX_HEADER,
    NO_TOGGLE,
    SAID_DOWNLOAD,
    SAID_DOWNLOAD_SEGMENT,
    SAID_UPLOAD,
    SAID_UPLOAD_SEGMENT,
    SDO_HEADER,
    SDO_INFORMATION,
    SDO_REQUEST,
    SDO_RESPONSE,
    SIZE_GIVEN,
    TOGGLE,
    UNSUPPORTED,
    UPLOAD,
    UPLOAD_SEGMENT,
)

from .objects import Objects, SdoRefusedError

_HEADERS = struct.calcsize(MAILBOX_HEADER) + struct.calcsize(COE_HEADER)
_UNSUPPORTED, _BAD_HEADER = 2, 8
"""What was wrong with a mail: its protocol, its header."""
_LEAST_SEGMENT = 7


class Mailbox:
    """Answers one mail at a time; a transfer in segments is remembered from one to the next."""

    def __init__(self, objects: Objects, size: int) -> None:
        """`size` is that of each mailbox in bytes."""
        self._objects, self._size = objects, size
        self._counter = 0
        self._rest: bytes | None = None
        """Of an upload: what is still to be sent."""
        self._coming: tuple[int, int, bool, int, bytes] | None = None
        """Of a download: index, subindex, whether complete, its length, what has come."""
        self._toggle = 0

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
            self._rest = self._coming = None
            said = struct.pack("<BHBI", ABORT << 5, index, subindex, refused.code)
            return self._mail(COE, struct.pack(COE_HEADER, SDO_REQUEST << 12) + said)
        return self._mail(COE, struct.pack(COE_HEADER, SDO_RESPONSE << 12) + said)

    def _mail(self, kind: int, body: bytes) -> bytes:
        self._counter = self._counter % 7 + 1
        return (struct.pack(MAILBOX_HEADER, len(body), 0, 0, kind | self._counter << 4) + body).ljust(self._size, b"\0")

    def _transferred(self, service: int, command: int, index: int, subindex: int, data: bytes) -> bytes:
        if service != SDO_REQUEST:
            raise SdoRefusedError(BAD_COMMAND)
        match command >> 5:
            case c if c == UPLOAD:
                return self._upload(command, index, subindex)
            case c if c == UPLOAD_SEGMENT:
                return self._upload_segment(command)
            case c if c == DOWNLOAD:
                return self._download(command, index, subindex, data)
            case c if c == DOWNLOAD_SEGMENT:
                segment = struct.pack("<HB", index, subindex) + data
                return self._download_segment(command, segment)
        raise SdoRefusedError(BAD_COMMAND)

    def _upload(self, command: int, index: int, subindex: int) -> bytes:
        complete = bool(command & COMPLETE)
        value = self._objects.complete(index, subindex) if complete else self._objects.read(index, subindex)
        head = SAID_UPLOAD << 5 | command & COMPLETE | SIZE_GIVEN
        if 1 <= len(value) <= 4 and not complete:
            head |= EXPEDITED | (4 - len(value)) << 2
            return struct.pack(SDO_HEADER, head, index, subindex) + value.ljust(4, b"\0")
        room = self._size - _HEADERS - 8
        self._rest, self._toggle = (value[room:] or None), 0
        return struct.pack(SDO_HEADER + "I", head, index, subindex, len(value)) + value[:room]

    def _upload_segment(self, command: int) -> bytes:
        if self._rest is None:
            raise SdoRefusedError(BAD_COMMAND)
        self._toggled(command)
        room = self._size - _HEADERS - 1
        part, rest = self._rest[:room], self._rest[room:]
        self._rest = rest or None
        head = SAID_UPLOAD_SEGMENT << 5 | command & TOGGLE | (0 if rest else LAST_SEGMENT)
        return bytes([head | _unused(part)]) + part.ljust(_LEAST_SEGMENT, b"\0")

    def _download(self, command: int, index: int, subindex: int, data: bytes) -> bytes:
        complete = bool(command & COMPLETE)
        if command & EXPEDITED:
            length = 4 - (command >> 2 & 3) if command & SIZE_GIVEN else 4
            self._store(index, subindex, complete, data[:length])
        else:
            (length,) = struct.unpack_from("<I", data)
            came = data[4 : 4 + length]
            if len(came) < length:
                self._coming, self._toggle = (index, subindex, complete, length, came), 0
            else:
                self._store(index, subindex, complete, came)
        return struct.pack(SDO_HEADER + "I", SAID_DOWNLOAD << 5, index, subindex, 0)

    def _download_segment(self, command: int, data: bytes) -> bytes:
        if self._coming is None:
            raise SdoRefusedError(BAD_COMMAND)
        self._toggled(command)
        index, subindex, complete, length, came = self._coming
        if len(data) <= _LEAST_SEGMENT:
            data = data[: _LEAST_SEGMENT - (command >> 1 & 7)]
        came += data
        self._coming = (index, subindex, complete, length, came)
        if command & LAST_SEGMENT:
            self._coming = None
            self._store(index, subindex, complete, came[:length])
        return struct.pack("<B7x", SAID_DOWNLOAD_SEGMENT << 5 | command & TOGGLE)

    def _store(self, index: int, subindex: int, complete: bool, data: bytes) -> None:
        if not complete:
            self._objects.write(index, subindex, data)
            return
        count, body = (data[0], data[2:]) if subindex == 0 else (None, data)
        width = 2 if 0x1C10 <= index < 0x1C20 else 4
        self._objects.write(index, 0, b"\0")
        entries = [body[at : at + width] for at in range(0, len(body), width)]
        for place, entry in enumerate(entries, 1):
            self._objects.write(index, place, entry)
        self._objects.write(index, 0, bytes([len(entries) if count is None else count]))

    def _toggled(self, command: int) -> None:
        if command & TOGGLE != self._toggle:
            raise SdoRefusedError(NO_TOGGLE)
        self._toggle ^= TOGGLE


def _unused(part: bytes) -> int:
    return max(0, _LEAST_SEGMENT - len(part)) << 1
