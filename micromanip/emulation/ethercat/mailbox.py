"""A slave's end of the mailbox: SDOs expedited and normal, with abort codes (ETG.1000.6); no others."""

from __future__ import annotations

import struct

from micromanip.bus.ethercat.coe import (
    ABORT,
    BAD_COMMAND,
    COE,
    COE_HEADER,
    COMPLETE,
    DOWNLOAD,
    ERROR_TYPE,
    EXPEDITED,
    INFORMATION_ERROR,
    MAILBOX_HEADER,
    SAID_DOWNLOAD,
    SAID_UPLOAD,
    SDO_HEADER,
    SDO_INFORMATION,
    SDO_REQUEST,
    SDO_RESPONSE,
    SIZE_GIVEN,
    UNSUPPORTED,
    UPLOAD,
)

from .objects import Objects, SdoRefusedError

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
