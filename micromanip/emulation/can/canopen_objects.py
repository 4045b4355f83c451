"""The object dictionary of a CANopen test node, and who may change what in it by SDO."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from canopen.objectdictionary import ODVariable, datatypes, import_od

PDO_OFF = 1 << 31
"""Bit of a PDO's COB-ID."""

READ_ONLY, WRITE_ONLY = 0x06010002, 0x06010001
NO_OBJECT, NO_SUBINDEX = 0x06020000, 0x06090011
NOT_MAPPABLE, TOO_LONG = 0x06040041, 0x06040042
WRONG_SIZE, WRONG_VALUE = 0x06070010, 0x06090030
UNSUPPORTED, NOT_IN_THIS_STATE = 0x06010000, 0x08000022

_RPDO, _TPDO = 0x1400, 0x1800
_RPDO_MAPPING, _TPDO_MAPPING = 0x1600, 0x1A00
_PDOS = 0x200
_HISTORY = 0x1003
_STORE = 0x1010
_SAVE = b"save"
_STRUCTS = ODVariable.STRUCT_TYPES


class Abort(Exception):  # noqa: N818
    """An SDO request that is refused, by its abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


@dataclass(frozen=True)
class Entry:
    """An object in a PDO."""

    variable: ODVariable
    first_bit: int
    bits: int


@dataclass(frozen=True)
class Pdo:
    """A PDO as it is set up now."""

    number: int
    identifier: int
    transmission: int
    event_ms: int
    entries: tuple[Entry, ...]

    @property
    def length(self) -> int:
        """Bytes of its frame."""
        return (sum(entry.bits for entry in self.entries) + 7) // 8


class Objects:
    """The objects of one node and their raw values."""

    def __init__(self, eds: Path, node_id: int) -> None:
        self._dictionary = import_od(str(eds), node_id)
        self._values: dict[tuple[int, int], int | float] = {}
        self.stores = 0
        """How often it was told to store its parameters: real memory wears out by that."""

    def forget(self, first: int = 0, end: int = 0x10000) -> None:
        """Set the objects from `first` up to `end` back to what the EDS says."""
        self._values = {at: value for at, value in self._values.items() if not first <= at[0] < end}

    def variable(self, index: int, subindex: int = 0) -> ODVariable:
        """An object. Raises Abort if there is none."""
        entry = self._dictionary.indices.get(index)
        if entry is None:
            raise Abort(NO_OBJECT)
        found = entry if isinstance(entry, ODVariable) else entry.subindices.get(subindex)
        if found is None or (found is entry and subindex):
            raise Abort(NO_SUBINDEX)
        return found

    def has(self, index: int, subindex: int = 0) -> bool:
        """True if there is such an object."""
        try:
            self.variable(index, subindex)
        except Abort:
            return False
        return True

    def raw(self, index: int, subindex: int = 0) -> int:
        """An object's value, as an integer."""
        value = self._values.get((index, subindex), self.variable(index, subindex).default)
        return int(value or 0)

    def put(self, index: int, subindex: int, value: int | float) -> None:
        """Set an object from inside the device."""
        self._values[index, subindex] = value

    def remember_error(self, code: int) -> None:
        """Put an emergency's code first into the history of errors, as far as there is one."""
        room = 0
        while self.has(_HISTORY, room + 1):
            room += 1
        codes = [code, *(self.raw(_HISTORY, i + 1) for i in range(self.raw(_HISTORY)))] if room else []
        for i, value in enumerate(codes[:room]):
            self.put(_HISTORY, i + 1, value)
        self.put(_HISTORY, 0, len(codes[:room]))

    def upload(self, index: int, subindex: int) -> bytes:
        """What an SDO client reads. Raises Abort."""
        variable = self.variable(index, subindex)
        if not variable.readable:
            raise Abort(WRITE_ONLY)
        if variable.data_type not in _STRUCTS or len(variable) > 32:
            raise Abort(UNSUPPORTED)  # expedited transfers only
        value = self._values.get((index, subindex), variable.default)
        return variable.encode_raw(0 if value is None else value)

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """What an SDO client writes. Raises Abort."""
        variable = self.variable(index, subindex)
        if not variable.writable:
            raise Abort(READ_ONLY)
        if index == _STORE:
            if data != _SAVE:
                raise Abort(WRONG_VALUE)
            self.stores += 1
            return
        if len(data) * 8 != len(variable):
            raise Abort(WRONG_SIZE)
        value = variable.decode_raw(data)
        assert isinstance(value, int | float)
        self._permit(index, subindex, value)
        self._values[index, subindex] = value

    def tpdos(self) -> Iterator[Pdo]:
        """The PDOs that it transmits."""
        return self._pdos(_TPDO, _TPDO_MAPPING)

    def rpdos(self) -> Iterator[Pdo]:
        """The PDOs that it receives."""
        return self._pdos(_RPDO, _RPDO_MAPPING)

    def _pdos(self, parameters: int, mapping: int) -> Iterator[Pdo]:
        for i in range(_PDOS):
            if parameters + i not in self._dictionary.indices:
                continue
            cob_id = self.raw(parameters + i, 1)
            if cob_id & PDO_OFF:
                continue
            event_ms = self.raw(parameters + i, 5) if self.has(parameters + i, 5) else 0
            entries = tuple(self._entries(mapping + i))
            yield Pdo(i + 1, cob_id & 0x7FF, self.raw(parameters + i, 2), event_ms, entries)

    def _entries(self, mapping: int) -> Iterator[Entry]:
        bit = 0
        for i in range(self.raw(mapping, 0)):
            word = self.raw(mapping, i + 1)
            yield Entry(self.variable(word >> 16, word >> 8 & 0xFF), bit, word & 0xFF)
            bit += word & 0xFF

    def _permit(self, index: int, subindex: int, value: int | float) -> None:
        """A PDO is changed only while it is off, and its objects only while it has none."""
        for parameters, mapping in ((_RPDO, _RPDO_MAPPING), (_TPDO, _TPDO_MAPPING)):
            i = index - mapping
            if not 0 <= i < _PDOS:
                continue
            if not self.raw(parameters + i, 1) & PDO_OFF or (subindex and self.raw(index, 0)):
                raise Abort(NOT_IN_THIS_STATE)
            if subindex:
                word = int(value)
                if not self.variable(word >> 16, word >> 8 & 0xFF).pdo_mappable:
                    raise Abort(NOT_MAPPABLE)
            elif sum(self.raw(index, k + 1) & 0xFF for k in range(int(value))) > 64:
                raise Abort(TOO_LONG)


def packed(entry: Entry, value: float) -> int:
    """The bits of a physical value in its PDO; a converter stays at its end where the value is beyond it."""
    variable = entry.variable
    if variable.data_type in datatypes.FLOAT_TYPES:
        raw = int.from_bytes(variable.encode_raw(value / variable.factor), "little")
    else:
        signed = variable.data_type in datatypes.SIGNED_TYPES
        low, high = (-(1 << entry.bits - 1), (1 << entry.bits - 1) - 1) if signed else (0, (1 << entry.bits) - 1)
        raw = low if math.isnan(value) else round(min(high, max(low, value / variable.factor)))
    return (raw & (1 << entry.bits) - 1) << entry.first_bit


def unpacked(entry: Entry, frame: int) -> float:
    """The physical value of an object in a PDO."""
    variable = entry.variable
    raw: int | float = frame >> entry.first_bit & (1 << entry.bits) - 1
    if variable.data_type in datatypes.FLOAT_TYPES:
        raw = variable.STRUCT_TYPES[variable.data_type].unpack(int(raw).to_bytes(entry.bits // 8, "little"))[0]
    elif variable.data_type in datatypes.SIGNED_TYPES and raw >= 1 << entry.bits - 1:
        raw -= 1 << entry.bits
    return raw * variable.factor
