"""CANopen over EtherCAT (CoE): headers of a slave's mailbox, commands of SDO transfers, abort codes."""

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

DOWNLOAD, UPLOAD, ABORT = 1, 2, 4
"""Requests (client command specifiers): bits 5 to 7 of an SDO's command."""
SAID_DOWNLOAD, SAID_UPLOAD = 3, 2
ANSWERS = {DOWNLOAD: SAID_DOWNLOAD, UPLOAD: SAID_UPLOAD}
"""Which answer (server command specifier) belongs to which request."""
COMPLETE, EXPEDITED, SIZE_GIVEN = 0x10, 0x02, 0x01
"""Bits of a command that begins a transfer."""

BAD_COMMAND, UNSUPPORTED = 0x05040001, 0x06010000
READ_ONLY, NO_OBJECT, NOT_MAPPABLE = 0x06010002, 0x06020000, 0x06040041
WRONG_LENGTH, NO_SUBINDEX, BAD_STATE = 0x06070010, 0x06090011, 0x08000022
