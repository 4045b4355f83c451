"""The master's end of a slave's mailbox: SDOs expedited and normal, by which PDOs are assigned and mapped."""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping, Sequence
from itertools import count

from micromanip.driver import DeviceFault, IdentityMismatch, LinkError
from micromanip.driver.ethercat import coe, registers

from .link import Link
from .options import InputPdo, OutputPdo
from .scan import Pdos, Slave

_ANSWER_S = 2.0
_SDO = struct.Struct(coe.SDO_HEADER)
_EMERGENCY = 1


class Mailbox:
    """Of one slave, which must be in PREOP at least."""

    def __init__(self, link: Link, slave: Slave, name: str) -> None:
        """`name` is for messages. Raises DeviceFault for a slave without CoE."""
        if slave.mailbox_out is None or slave.mailbox_in is None:
            raise DeviceFault(f"{link.name}: terminal {name} has no CoE mailbox")
        self._link, self._station, self._name = link, slave.station, name
        self._out, self._in = slave.mailbox_out, slave.mailbox_in
        self._counter = count()
        self._heard, self._is_asked_again = 0, False

    def read(self, index: int, subindex: int) -> bytes:
        """An object's entry that one mail holds. Raises DeviceFault with the abort code, and for a longer one."""
        said, body = self._asked(index, subindex, _SDO.pack(coe.UPLOAD << 5, index, subindex) + bytes(4))
        if said & coe.EXPEDITED:
            return body[: 4 - (said >> 2 & 3)] if said & coe.SIZE_GIVEN else body[:4]
        (length,) = struct.unpack_from("<I", body)
        if len(body) < 4 + length:
            raise DeviceFault(
                f"{self._link.name}: terminal {self._name}: object 0x{index:04x}:{subindex:02x} has {length} bytes, "
                "more than one mail holds"
            )
        return body[4 : 4 + length]

    def read_number(self, index: int, subindex: int, size: int) -> int:
        """An unsigned number of `size` bytes. Raises DeviceFault also where the object has another length."""
        data = self.read(index, subindex)
        if len(data) != size:
            raise DeviceFault(
                f"{self._link.name}: terminal {self._name}: object 0x{index:04x}:{subindex:02x} has {len(data)} bytes "
                f"instead of {size}"
            )
        return int.from_bytes(data, "little")

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object's entry, of 8 bytes at most. Raises DeviceFault with the abort code."""
        command, sent = coe.DOWNLOAD << 5 | coe.SIZE_GIVEN, struct.pack("<I", len(data)) + data
        if len(data) <= 4:
            command, sent = command | coe.EXPEDITED | (4 - len(data)) << 2, data.ljust(4, b"\0")
        self._asked(index, subindex, _SDO.pack(command, index, subindex) + sent)

    def _asked(self, index: int, subindex: int, sdo: bytes) -> tuple[int, bytes]:
        """Command and data of the answer to a request."""
        body = struct.pack(coe.COE_HEADER, coe.SDO_REQUEST << 12) + sdo
        head = struct.pack(coe.MAILBOX_HEADER, len(body), 0, 0, coe.COE | (next(self._counter) % 7 + 1) << 4)
        self._send((head + body).ljust(self._out[1], b"\0"))
        end = time.monotonic() + _ANSWER_S
        while True:
            mail = self._next(end)
            length, _, _, kind = struct.unpack_from(coe.MAILBOX_HEADER, mail)
            answer, heard, self._heard = mail[6 : 6 + length], self._heard, kind >> 4
            is_repeated, self._is_asked_again = self._is_asked_again and 0 < self._heard == heard, False
            if is_repeated or kind & 0x0F != coe.COE or len(answer) < 3 or answer[1] >> 4 == _EMERGENCY:
                self._require_before(end)
                continue  # of another protocol, or the device's own: the AL state tells of what matters
            said = answer[2]
            if said >> 5 == coe.ABORT and len(answer) >= 10:
                from canopen.sdo.exceptions import SdoAbortedError  # the loop's process has no other use for it

                aborted = SdoAbortedError(*struct.unpack_from("<I", answer, 6))
                raise DeviceFault(
                    f"{self._link.name}: terminal {self._name} refuses object 0x{index:04x}:{subindex:02x}: {aborted}"
                )
            if said >> 5 != coe.ANSWERS[sdo[0] >> 5]:
                self._require_before(end)
                continue  # it belongs to an earlier request
            if len(answer) >= 10 and _SDO.unpack_from(answer, 2)[1:] == (index, subindex):
                return said, answer[6:]
            self._require_before(end)

    def _send(self, mail: bytes) -> None:
        end = time.monotonic() + _ANSWER_S
        while self._link.write(registers.FPWR, self._station, self._out[0], mail).wkc != 1:
            if time.monotonic() > end:
                raise LinkError(f"{self._link.name}: the mailbox of terminal {self._name} takes nothing")

    def _next(self, end: float) -> bytes:
        start, length = self._in
        while True:
            lost = self._link.lost
            back = self._link.read(registers.FPRD, self._station, start, length)
            if back.wkc == 1:
                return back.data
            self._require_before(end)
            if self._link.lost != lost:
                self._ask_again(end)

    def _ask_again(self, end: float) -> None:
        """A frame was lost that may have fetched the mail already: the slave lays it out once more (ETG.1000.4)."""
        self._is_asked_again = True
        at = registers.SM + registers.SM_BYTES + registers.SM_ACTIVATE
        activate = self._link.station_read(self._station, at, 1)[0] ^ registers.SM_REPEAT
        self._link.station_write(self._station, at, bytes([activate]))
        pdi_at = at - registers.SM_ACTIVATE + registers.SM_PDI
        while (self._link.station_read(self._station, pdi_at, 1)[0] ^ activate) & registers.SM_REPEAT:
            self._require_before(end)

    def _require_before(self, end: float) -> None:
        if time.monotonic() > end:
            raise LinkError(f"{self._link.name}: the mailbox of terminal {self._name} does not answer")


_ASSIGNED = {"outputs": 0x1C12, "inputs": 0x1C13}
_PDO_BYTES, _ENTRY_BYTES = 2, 4


def apply_mapping(mailbox: Mailbox, name: str, direction: str, pdos: Mapping[str, OutputPdo | InputPdo]) -> None:
    """Let the terminal's process data of one direction be those of the configuration.

    Raises IdentityMismatch where the terminal keeps to others.
    """
    wanted = _wanted(pdos)
    assigned = _ASSIGNED[direction]
    there = _mapped(mailbox, assigned)
    if there == wanted:
        return
    try:
        _write(mailbox, assigned, wanted)
        there = _mapped(mailbox, assigned)
        refusal = ""
    except DeviceFault as refused:
        refusal = f" and it can't be changed: {refused}"
    if there != wanted:
        raise _mismatch(name, direction, there, wanted, refusal)


def require_mapping(name: str, direction: str, pdos: Mapping[str, OutputPdo | InputPdo], there: Pdos) -> None:
    """Of a terminal without a mailbox, whose PDOs are fixed and stand in its EEPROM; all of a direction, or none.

    Raises IdentityMismatch.
    """
    wanted = _wanted(pdos)
    if wanted and list(there) != wanted:
        raise _mismatch(name, direction, there, wanted, " and it can't be changed: the terminal has no mailbox")


def _wanted(pdos: Mapping[str, OutputPdo | InputPdo]) -> Pdos:
    return [(pdo.pdo, [field.mapping for field in pdo.fields.values()]) for pdo in pdos.values()]


def _mismatch(name: str, direction: str, there: Pdos, wanted: Pdos, refusal: str) -> IdentityMismatch:
    return IdentityMismatch(
        f"terminal {name}: its {direction} are {_in_words(there)}, configured are {_in_words(wanted)}{refusal}"
    )


def _mapped(mailbox: Mailbox, assigned: int) -> Pdos:
    try:
        pdos = _numbers(mailbox, assigned, _PDO_BYTES)
    except DeviceFault:  # it has none of this direction
        return []
    return [(pdo, _numbers(mailbox, pdo, _ENTRY_BYTES)) for pdo in pdos]


def _numbers(mailbox: Mailbox, index: int, size: int) -> Sequence[int]:
    count = mailbox.read_number(index, 0, 1)
    return [mailbox.read_number(index, place + 1, size) for place in range(count)]


def _write(mailbox: Mailbox, assigned: int, pdos: Pdos) -> None:
    """Nothing may be assigned while a PDO is mapped, nor mapped while it has entries."""
    mailbox.write(assigned, 0, b"\0")
    for index, entries in pdos:
        if _numbers(mailbox, index, _ENTRY_BYTES) == entries:
            continue
        mailbox.write(index, 0, b"\0")
        for place, entry in enumerate(entries, 1):
            mailbox.write(index, place, struct.pack("<I", entry))
        mailbox.write(index, 0, bytes([len(entries)]))
    for place, (index, _) in enumerate(pdos, 1):
        mailbox.write(assigned, place, struct.pack("<H", index))
    mailbox.write(assigned, 0, bytes([len(pdos)]))


def _in_words(pdos: Pdos) -> str:
    return "; ".join(f"0x{i:04x}: {' '.join(f'0x{entry:08x}' for entry in entries)}" for i, entries in pdos) or "none"
