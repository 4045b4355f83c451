"""The object dictionary of a CANopen test node, and who may change what in it by SDO: the library's server answers."""

from __future__ import annotations

import contextlib
import logging
import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from canopen import LocalNode, SdoAbortedError
from canopen.objectdictionary import ODVariable, datatypes

logging.getLogger("canopen").addHandler(logging.NullHandler())

PDO_OFF = 1 << 31
"""Bit of a PDO's COB-ID."""

NOT_MAPPABLE, TOO_LONG = 0x06040041, 0x06040042
WRONG_VALUE, NOT_IN_THIS_STATE = 0x06090030, 0x08000022

_RPDO, _TPDO = 0x1400, 0x1800
_RPDO_MAPPING, _TPDO_MAPPING = 0x1600, 0x1A00
_PDOS = 0x200
_DUMMIES = 0x20
"""Objects below stand for data types: gaps in a PDO."""
_HISTORY = 0x1003
_STORE = 0x1010
_SAVE = b"save"


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
    length: int
    """Bytes of its frame."""
    entries: tuple[Entry, ...]
    """Without gaps."""


class Objects:
    """The objects of one node and their raw values."""

    def __init__(self, eds: Path, node_id: int, answer: Callable[[bytes], object]) -> None:
        """`answer` sends what the SDO server says."""
        self.node = LocalNode(node_id, str(eds))
        self.node.sdo.network = self  # type: ignore[assignment]  # all that the server asks of one
        self._answer = answer
        self.node._write_callbacks[:] = [self._permit]  # not the library's heartbeat, which needs a thread
        self.stores = 0
        """How often it was told to store its parameters: real memory wears out by that."""

    def send_message(self, identifier: int, data: bytes) -> None:  # noqa: ARG002
        """What the server calls."""
        self._answer(bytes(data))

    def serve(self, request: bytes) -> None:
        """Answer what an SDO client asks."""
        with contextlib.suppress(struct.error):  # the server can't refuse a segment of no transfer
            self.node.sdo.on_request(0, bytearray(request), 0.0)  # type: ignore[no-untyped-call]

    def forget(self, first: int = 0, end: int = 0x10000) -> None:
        """Set the objects from `first` up to `end` back to what the EDS says."""
        for index in [index for index in self.node.data_store if first <= index < end]:
            del self.node.data_store[index]

    def variable(self, index: int, subindex: int = 0) -> ODVariable:
        """An object. Raises SdoAbortedError if there is none."""
        found: ODVariable = self.node._find_object(index, subindex)  # type: ignore[no-untyped-call]
        return found

    def has(self, index: int, subindex: int = 0) -> bool:
        """True if there is such an object."""
        try:
            self.variable(index, subindex)
        except SdoAbortedError:
            return False
        return True

    def raw(self, index: int, subindex: int = 0) -> int:
        """An object's value, as an integer; 0 where the EDS says none."""
        variable = self.variable(index, subindex)
        try:
            return int(variable.decode_raw(self.node.get_data(index, subindex)))
        except SdoAbortedError:
            return 0

    def put(self, index: int, subindex: int, value: int | float) -> None:
        """Set an object from inside the device."""
        data = self.variable(index, subindex).encode_raw(value)
        self.node.data_store.setdefault(index, {})[subindex] = data

    def put_raw(self, entry: Entry, frame: int) -> None:
        """Set an object to its bits in a PDO."""
        data = (frame >> entry.first_bit & (1 << entry.bits) - 1).to_bytes((entry.bits + 7) // 8, "little")
        self.node.data_store.setdefault(entry.variable.index, {})[entry.variable.subindex] = data

    def remember_error(self, code: int) -> None:
        """Put an emergency's code first into the history of errors, as far as there is one."""
        room = 0
        while self.has(_HISTORY, room + 1):
            room += 1
        codes = [code, *(self.raw(_HISTORY, i + 1) for i in range(self.raw(_HISTORY)))] if room else []
        for i, value in enumerate(codes[:room]):
            self.put(_HISTORY, i + 1, value)
        if room:
            self.put(_HISTORY, 0, len(codes[:room]))

    def tpdos(self) -> Iterator[Pdo]:
        """The PDOs that it transmits."""
        return self._pdos(_TPDO, _TPDO_MAPPING)

    def rpdos(self) -> Iterator[Pdo]:
        """The PDOs that it receives."""
        return self._pdos(_RPDO, _RPDO_MAPPING)

    def _pdos(self, parameters: int, mapping: int) -> Iterator[Pdo]:
        for i in range(_PDOS):
            if parameters + i not in self.node.object_dictionary:
                continue
            cob_id = self.raw(parameters + i, 1)
            if cob_id & PDO_OFF:
                continue
            event_ms = self.raw(parameters + i, 5) if self.has(parameters + i, 5) else 0
            bits, entries = self._mapped(mapping + i)
            yield Pdo(i + 1, cob_id & 0x7FF, self.raw(parameters + i, 2), event_ms, (bits + 7) // 8, tuple(entries))

    def _mapped(self, mapping: int) -> tuple[int, list[Entry]]:
        """How many bits a mapping has, and the objects in them."""
        bit, entries = 0, []
        for i in range(self.raw(mapping, 0)):
            word = self.raw(mapping, i + 1)
            if word >> 16 >= _DUMMIES:
                entries.append(Entry(self.variable(word >> 16, word >> 8 & 0xFF), bit, word & 0xFF))
            bit += word & 0xFF
        return bit, entries

    def _permit(self, index: int, subindex: int, od: Any, data: bytes) -> None:  # noqa: ARG002
        """A PDO is changed only while it is off, and its objects only while it has none."""
        if index == _STORE:
            if bytes(data) != _SAVE:
                raise SdoAbortedError(WRONG_VALUE)
            self.stores += 1
        value = int.from_bytes(data, "little")
        for parameters, mapping in ((_RPDO, _RPDO_MAPPING), (_TPDO, _TPDO_MAPPING)):
            i = index - mapping
            if not 0 <= i < _PDOS:
                continue
            if not self.raw(parameters + i, 1) & PDO_OFF or (subindex and self.raw(index, 0)):
                raise SdoAbortedError(NOT_IN_THIS_STATE)
            if subindex:
                if not self.variable(value >> 16, value >> 8 & 0xFF).pdo_mappable:
                    raise SdoAbortedError(NOT_MAPPABLE)
            elif sum(self.raw(index, k + 1) & 0xFF for k in range(value)) > 64:
                raise SdoAbortedError(TOO_LONG)


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
        raw = variable.STRUCT_TYPES[variable.data_type].unpack(int(raw).to_bytes((entry.bits + 7) // 8, "little"))[0]
    elif variable.data_type in datatypes.SIGNED_TYPES and raw >= 1 << entry.bits - 1:
        raw -= 1 << entry.bits
    return raw * variable.factor
