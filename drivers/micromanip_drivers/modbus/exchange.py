"""One request and its answer: which bytes go out, and what must come back.

The library builds each request once, when the driver is built; afterwards only the data in it are replaced. Of an
answer everything but the data is known beforehand, its length too, and is compared: stricter than a parser that takes
whatever has the form of an answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pymodbus.pdu import DecodePDU, ModbusPDU

from .codec import CoilPlan, Field, ReadPlan, WritePlan

_SINGLE = (5, 6)
"""Functions whose answer has the value that was taken."""
_COIL_ON = b"\xff\x00"


@dataclass(frozen=True)
class Block:
    """Registers, or coils, that follow each other."""

    first: int
    """Address of the first one, as it goes over the wire."""
    count: int
    fields: tuple[Field, ...]


class Exchange:
    """A transaction with one unit."""

    def __init__(self, unit_id: int, title: str, function: int, read: Block | None, write: Block | None) -> None:
        """`title` names it to people."""
        self.unit_id, self.title, self.function = unit_id, title, function
        self.written = write
        self.inputs = [field.name for field in read.fields] if read else []
        self._coils = function in (1, 2)
        self._reads = (CoilPlan if self._coils else ReadPlan)(read.fields) if read else None
        self._writes = WritePlan(write.fields, write.count) if write else None
        written = 2 if function == 5 else self._writes.length if self._writes else 0
        whole = bytes((function,)) + _library_request(function, read, write).encode()
        self._head = whole[: len(whole) - written]
        self.request_bytes = len(whole)
        """Length of the request, from the function code on."""
        self._data_bytes = (read.count + 7) // 8 if self._coils and read else 2 * read.count if read else 0
        self.answer_bytes = 2 + self._data_bytes if read else 5
        """Length of the answer, from the function code on."""

    def request(self, values: Mapping[str, float]) -> bytes:
        """What is sent, from the function code on; raises OutputRefused. `values` are those of the outputs, by name."""
        if self._writes is None:
            return self._head
        data = self._writes.data(values)
        if self.function == 5:
            data = _COIL_ON if data != b"\0" else b"\0\0"
        return self._head + data

    def answer_head(self, request: bytes) -> bytes:
        """How the answer must begin."""
        return bytes((self.function, self._data_bytes)) if self._reads else request[:3]

    def refusal(self, request: bytes, answer: bytes) -> str | None:
        """In numbers, what the device took instead of what was written; None where it says that it took that."""
        if self._reads or self.written is None or answer == request[: len(answer)]:
            return None
        took, wished = (int.from_bytes(pdu[3:5], "big") for pdu in (answer, request))
        address = self.written.fields[0].register.address
        if self.function in _SINGLE:
            return f"{self.title}: register {address} was set to {took} instead of {wished}: does the device limit it?"
        return f"{self.title}: {took} registers were written from {address} on instead of {wished}"

    def codes(self, answer: bytes) -> Sequence[float]:
        """The numbers in an answer, in the order of `inputs`."""
        return self._reads.codes(answer[2:]) if self._reads else ()

    def values(self, answer: bytes) -> Sequence[float]:
        """The same with scale and offset."""
        return self._reads.values(answer[2:]) if self._reads else ()


def _library_request(function: int, read: Block | None, write: Block | None) -> ModbusPDU:
    kind: Any = DecodePDU(is_server=True).lookupPduClass(bytes((0, function)))
    request: ModbusPDU
    if read and write:
        request = kind(read.first, read.count, write.first, [0] * write.count)
    elif read:
        request = kind(address=read.first, count=read.count)
    else:
        assert write is not None
        request = kind(address=write.first, **{"bits" if function in (5, 15) else "registers": [0] * write.count})
    return request
