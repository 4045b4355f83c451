"""PDO assignment and mapping of a terminal: read, written where they differ, and read again."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

from micromanip.driver import DeviceFault, IdentityMismatch

from .mailbox import Mailbox
from .options import InputPdo, OutputPdo
from .scan import Pdos

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
