"""The object dictionary of an emulated slave: identity, PDOs and their assignment, its own settings."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

from micromanip.bus.ethercat.coe import BAD_STATE, NO_OBJECT, NO_SUBINDEX, NOT_MAPPABLE, READ_ONLY, WRONG_LENGTH

from .terminal import Entry, Terminal

_PDO_OF_OUTPUTS, _PDO_OF_INPUTS, _PDOS = 0x1600, 0x1A00, 0x200
_SYNC_TYPES, _ASSIGNED_OUTPUTS, _ASSIGNED_INPUTS = 0x1C00, 0x1C12, 0x1C13


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
        for assigned, pdos in ((_ASSIGNED_OUTPUTS, terminal.outputs), (_ASSIGNED_INPUTS, terminal.inputs)):
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

    @property
    def mapped_outputs(self) -> Sequence[Entry]:
        """Of the outputs."""
        return self.mapped(_ASSIGNED_OUTPUTS)

    @property
    def mapped_inputs(self) -> Sequence[Entry]:
        """Of the inputs."""
        return self.mapped(_ASSIGNED_INPUTS)

    def _words(self, index: int, form: str) -> list[int]:
        entries = self._data.get(index, [b"\0"])
        return [struct.unpack(form, entry)[0] for entry in entries[1 : entries[0][0] + 1]]

    def _width(self, index: int) -> int:
        """Of the entries of an object by which PDOs are made."""
        if index not in self._data:
            raise SdoRefusedError(NO_OBJECT)
        assigns = index in (_ASSIGNED_OUTPUTS, _ASSIGNED_INPUTS)
        if not assigns and not any(first <= index < first + _PDOS for first in (_PDO_OF_OUTPUTS, _PDO_OF_INPUTS)):
            raise SdoRefusedError(READ_ONLY)
        if not self._may_map():
            raise SdoRefusedError(BAD_STATE)
        return 2 if assigns else 4


def _array(entries: Sequence[bytes]) -> list[bytes]:
    return [bytes([len(entries)]), *entries]
