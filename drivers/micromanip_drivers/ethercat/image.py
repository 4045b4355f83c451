"""The process image and the frame of a cycle: who lies where, as tables for the loop.

One Ethernet frame carries four datagrams: NOP with the cycle's count, which comes back as it is and so says which frame
it was; LRW of the whole image, all outputs before all inputs; BRD of AL status, the `or` of all slaves; and, with
clocks, ARMW of the system time from the first clock that it comes by, the first terminal's, to the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.driver.ethercat import (
    DATAGRAM_BYTES,
    HEADER_BYTES,
    PROCESSED,
    STATUS_BYTES,
    WKC_BYTES,
    Datagram,
    framed,
    registers,
)
from micromanip.driver.wire import FramePlan, GroupPlan

from .drive_options import DriveObject, fields_of
from .link import LOOP_SENDERS, SENDER
from .options import OK, EthercatOptions, Input

COUNT_BYTES, TIME_BYTES = 4, 8


@dataclass(frozen=True)
class Placed:
    """A terminal in the process image: first byte and length of its outputs and of its inputs."""

    outputs_at: int
    output_bytes: int
    inputs_at: int
    input_bytes: int


class Image:
    """Of the configuration; offline."""

    def __init__(self, options: EthercatOptions) -> None:
        self._options = options
        terminals = options.terminals
        lengths = {name: (_bytes(t.outputs), _bytes(t.inputs)) for name, t in terminals.items()}
        outputs, inputs = 0, sum(out for out, _ in lengths.values())
        self.placed: dict[str, Placed] = {}
        for name, (out, in_) in lengths.items():
            self.placed[name] = Placed(outputs, out, inputs, in_)
            outputs, inputs = outputs + out, inputs + in_
        self.bytes = inputs
        self.working_counter = sum(2 * (out > 0) + (in_ > 0) for out, in_ in lengths.values())
        """What LRW must come back with: 1 for each terminal that is read, 2 for each that is written."""
        self.count_at = HEADER_BYTES + DATAGRAM_BYTES
        self.image_at = self.count_at + COUNT_BYTES + WKC_BYTES + DATAGRAM_BYTES
        self.status_at = self.image_at + self.bytes + WKC_BYTES + DATAGRAM_BYTES
        self.time_at = self.status_at + STATUS_BYTES + WKC_BYTES + DATAGRAM_BYTES
        self.position_at = self.status_at - DATAGRAM_BYTES + 2
        """Of the broadcast: each slave counts it up, as it does the position of the clock that is read."""
        self.clock_position_at = self.time_at - DATAGRAM_BYTES + 2

    @property
    def frame(self) -> bytes:
        """As it is sent, but for count and outputs."""
        datagrams = [
            Datagram(registers.NOP, (0, 0), bytes(COUNT_BYTES)),
            Datagram(registers.LRW, 0, bytes(self.bytes)),
            Datagram(registers.BRD, (0, registers.AL_STATUS), bytes(STATUS_BYTES)),
        ]
        if self._options.clocks:
            datagrams.append(Datagram(registers.ARMW, (0, registers.DC_SYSTEM), bytes(TIME_BYTES)))
        return framed(datagrams, LOOP_SENDERS[0])

    @property
    def inputs_at(self) -> Sequence[int]:
        """Where in the frame the inputs of each terminal begin, and last of all where they end."""
        return [self.image_at + at for at in (*(placed.inputs_at for placed in self.placed.values()), self.bytes)]

    @property
    def inputs(self) -> Mapping[str, Input]:
        """By name, in the order in which the loop gets them: what is fresh in each cycle, slower PDOs, drives."""
        pdos = [pdo for terminal in self._options.terminals.values() for pdo in terminal.inputs.values()]
        pdos.sort(key=lambda pdo: pdo.counter is not None)
        read = {name: field for pdo in pdos for name, field in pdo.fields.items()}
        return read | {drive.ok: OK for drive in self._options.drives.values()}

    def word_at(self, terminal: str, direction: str, wanted: DriveObject) -> int:
        """Where in the frame an object of a drive begins, that of `outputs` or `inputs`."""
        placed, pdos = self.placed[terminal], getattr(self._options.terminals[terminal], direction)
        start = self.image_at + (placed.outputs_at if direction == "outputs" else placed.inputs_at)
        ((name, _),) = fields_of(pdos, wanted)
        return next(numbers[name].at for _, numbers in _numbers(pdos, start) if name in numbers)

    def sent(self) -> NDArray[np.void]:
        """The table of the frame that is sent."""
        fields: dict[str, Number] = {}
        for terminal, placed in zip(self._options.terminals.values(), self.placed.values(), strict=True):
            for _, numbers in _numbers(terminal.outputs, self.image_at + placed.outputs_at):
                fields |= numbers
        fields = {name: fields.get(name, NOWHERE) for name in self._options.outputs}
        count = Number(self.count_at, COUNT_BYTES, "uint32")
        return FramePlan(len(self.frame), [GroupPlan(fields)], self.frame, counter=count).record()

    def received(self) -> NDArray[np.void]:
        """The table of the one that comes back: its headers are as they were sent, or as slaves change them."""
        fields: dict[str, Number] = {}
        latency_us, slow = 0.0, []
        for terminal, placed in zip(self._options.terminals.values(), self.placed.values(), strict=True):
            for pdo, numbers in _numbers(terminal.inputs, self.image_at + placed.inputs_at):
                if pdo.counter is None:
                    fields |= numbers
                    latency_us = max(latency_us, pdo.latency_us)
                else:
                    slow.append(GroupPlan(numbers, numbers[pdo.counter], round(pdo.latency_us * 1e3)))
        count = Number(self.count_at, COUNT_BYTES, "uint32")
        clock = Number(self.time_at, TIME_BYTES, "uint64") if self._options.clocks else None
        groups = [GroupPlan(fields, latency_ns=round(latency_us * 1e3)), *slow]
        record = FramePlan(len(self.frame), groups, counter=count, clock=clock).record()
        template, fixed = bytearray(self.frame), record[0]["fixed"]
        template[SENDER] |= PROCESSED
        for at in (self.position_at, *((self.clock_position_at,) if self._options.clocks else ())):
            template[at : at + 2] = len(self._options.terminals).to_bytes(2, "little")
        record[0]["template"][: len(template)] = np.frombuffer(template, np.uint8)
        fixed[SENDER : self.count_at] = 1
        for data_at in (self.image_at, self.status_at, *((self.time_at,) if self._options.clocks else ())):
            fixed[data_at - DATAGRAM_BYTES : data_at] = 1
        return record


@dataclass(frozen=True)
class Number:
    """A number of the frame, as ``FramePlan`` takes it; EtherCAT's byte order is little."""

    at: int
    size: int
    type: str
    scale: float = 1.0
    offset: float = 0.0
    range: tuple[float, float] | None = None
    byte_order: str = "little"


NOWHERE = Number(0, 0, "uint8")
"""Of a switch that a drive goes by: it takes no bytes of the frame."""


def _numbers(pdos: Mapping[str, Any], at: int) -> Iterator[tuple[Any, dict[str, Number]]]:
    """Each PDO with its numbers, one behind the other from byte `at` of the frame on."""
    for pdo in pdos.values():
        numbers = {}
        for name, field in pdo.fields.items():
            numbers[name] = Number(at, field.size, field.type, field.scale, field.offset, getattr(field, "range", None))
            at += field.size
        yield pdo, numbers


def _bytes(pdos: Mapping[str, Any]) -> int:
    return sum(field.size for pdo in pdos.values() for field in pdo.fields.values())
