"""CANopen over EtherCAT (CoE): headers of a slave's mailbox, commands of SDO transfers, abort codes in words."""

from __future__ import annotations

MAILBOX_HEADER, COE_HEADER, SDO_HEADER = "<HHBB", "<H", "<BHB"
"""Length, station, channel, type and counter; number and service; command, index, subindex."""
COE = 3
SDO_REQUEST, SDO_RESPONSE, SDO_INFORMATION = 2, 3, 8
"""Services of CoE."""
INFORMATION_ERROR = 7
"""Answer of the last that says why there is no other: an abort code."""
ERROR_TYPE = 0
"""Type of a mail that says what was wrong with the one before."""

DOWNLOAD_SEGMENT, DOWNLOAD, UPLOAD, UPLOAD_SEGMENT, ABORT = 0, 1, 2, 3, 4
"""Requests (client command specifiers): bits 5 to 7 of an SDO's command."""
SAID_DOWNLOAD_SEGMENT, SAID_DOWNLOAD, SAID_UPLOAD, SAID_UPLOAD_SEGMENT = 1, 3, 2, 0
"""Their answers (server command specifiers)."""
ANSWERS = {
    DOWNLOAD_SEGMENT: SAID_DOWNLOAD_SEGMENT,
    DOWNLOAD: SAID_DOWNLOAD,
    UPLOAD: SAID_UPLOAD,
    UPLOAD_SEGMENT: SAID_UPLOAD_SEGMENT,
}
"""Which answer belongs to which request."""
COMPLETE, EXPEDITED, SIZE_GIVEN = 0x10, 0x02, 0x01
"""Bits of a command that begins a transfer."""
TOGGLE, LAST_SEGMENT = 0x10, 0x01
"""Bits of a command that goes on with one."""

NO_TOGGLE, BAD_COMMAND = 0x05030000, 0x05040001
UNSUPPORTED = 0x06010000
WRITE_ONLY, READ_ONLY, NO_OBJECT, NOT_MAPPABLE = 0x06010001, 0x06010002, 0x06020000, 0x06040041
WRONG_LENGTH, NO_SUBINDEX, BAD_STATE = 0x06070010, 0x06090011, 0x08000022

_ABORTS = {
    0x05030000: "the toggle bit did not change",
    0x05040000: "time-out of the SDO protocol",
    0x05040001: "unknown command specifier",
    0x05040005: "out of memory",
    0x06010000: "unsupported access to an object",
    0x06010001: "the object can only be written",
    0x06010002: "the object can only be read",
    0x06010003: "subindex 0 must be 0 before the others are written",
    0x06010004: "complete access is not supported for this object",
    0x06020000: "there is no such object",
    0x06040041: "the object can't be mapped into a PDO",
    0x06040042: "more is mapped than the PDO has room for",
    0x06040043: "parameters don't fit together",
    0x06040047: "internal incompatibility of the device",
    0x06060000: "hardware error",
    0x06070010: "type and length of the object are others",
    0x06070012: "too long for the object",
    0x06070013: "too short for the object",
    0x06090011: "there is no such subindex",
    0x06090030: "value out of range",
    0x06090031: "value too great",
    0x06090032: "value too small",
    0x08000000: "general error",
    0x08000020: "can't be stored",
    0x08000021: "can't be stored: local control",
    0x08000022: "can't be stored in this state of the device",
    0x08000023: "there is no object dictionary",
}


def abort_in_words(code: int) -> str:
    """What an SDO abort code means."""
    return _ABORTS.get(code, "unknown abort code")
