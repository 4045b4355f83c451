"""The process image and the frame of a cycle: who lies where, as tables for the loop.

One Ethernet frame carries four datagrams: NOP with the cycle's count, which comes back as it is and so says which frame
it was; LRW of the whole image, all outputs before all inputs; BRD of AL status, the `or` of all slaves; and, with
clocks, ARMW of the system time from the first clock that it comes by, the first terminal's, to the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    PackedNumber,
    bytes_of,
    framed,
    packed_numbers,
    registers,
)
from micromanip.driver.wire import FramePlan, GroupPlan, put_value

from .link import LOOP_SENDERS, SENDER
from .options import EthercatOptions, Input, OutputPdo

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
        """Raises ConfigError for a drive whose objects begin within a byte."""
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
        """By name, in the order in which the loop gets them: what is fresh in each cycle, slower PDOs."""
        pdos = [pdo for terminal in self._options.terminals.values() for pdo in terminal.inputs.values()]
        pdos.sort(key=lambda pdo: pdo.counter is not None)
        return {name: field for pdo in pdos for name, field in pdo.fields.items() if field.is_channel}

    def sent(self) -> NDArray[np.void]:
        """The table of the frame that is sent."""
        fields: dict[str, PackedNumber] = {}
        frame = np.frombuffer(self.frame, np.uint8).copy()
        for terminal, placed in zip(self._options.terminals.values(), self.placed.values(), strict=True):
            for pdo, numbers in packed_numbers(terminal.outputs, self.image_at + placed.outputs_at):
                fields |= {name: each for name, each in numbers.items() if pdo.fields[name].is_channel}
                self._put_spare(frame, pdo, numbers)
        return FramePlan(len(frame), [GroupPlan(fields)], frame.tobytes(), counter=self._count).record()

    def _put_spare(self, frame: NDArray[np.uint8], pdo: OutputPdo, numbers: Mapping[str, PackedNumber]) -> None:
        """Write what outputs that nobody needs stay at."""
        safe = {name: field.safe for name, field in pdo.fields.items() if field.index and field.spare}
        plan = FramePlan(len(frame), [GroupPlan({name: numbers[name] for name in safe})]).record()[0]
        for number, value in zip(plan["number"], safe.values(), strict=False):
            put_value(plan, number, frame, value)

    @property
    def _count(self) -> PackedNumber:
        return _whole(self.count_at, COUNT_BYTES)

    def received(self) -> NDArray[np.void]:
        """The table of the one that comes back: its headers are as they were sent, or as slaves change them."""
        fields: dict[str, PackedNumber] = {}
        latency_us, slow = 0.0, []
        for terminal, placed in zip(self._options.terminals.values(), self.placed.values(), strict=True):
            for pdo, placed_numbers in packed_numbers(terminal.inputs, self.image_at + placed.inputs_at):
                numbers = {name: each for name, each in placed_numbers.items() if pdo.fields[name].is_channel}
                if pdo.counter is None:
                    fields |= numbers
                    latency_us = max(latency_us, pdo.latency_us)
                else:
                    slow.append(GroupPlan(numbers, numbers[pdo.counter], round(pdo.latency_us * 1e3)))
        clock = _whole(self.time_at, TIME_BYTES) if self._options.clocks else None
        groups = [GroupPlan(fields, latency_ns=round(latency_us * 1e3)), *slow]
        record = FramePlan(len(self.frame), groups, counter=self._count, clock=clock).record()
        template, fixed = bytearray(self.frame), record[0]["fixed"]
        template[SENDER] |= PROCESSED
        for at in (self.position_at, *((self.clock_position_at,) if self._options.clocks else ())):
            template[at : at + 2] = len(self._options.terminals).to_bytes(2, "little")
        record[0]["template"][: len(template)] = np.frombuffer(template, np.uint8)
        fixed[SENDER : self.count_at] = 1
        for data_at in (self.image_at, self.status_at, *((self.time_at,) if self._options.clocks else ())):
            fixed[data_at - DATAGRAM_BYTES : data_at] = 1
        return record


def _whole(at: int, size: int) -> PackedNumber:
    """An unsigned number of whole bytes."""
    return PackedNumber(at, size, 0, 8 * size, f"uint{8 * size}")


def _bytes(pdos: Mapping[str, Any]) -> int:
    return bytes_of(field.bits for pdo in pdos.values() for field in pdo.fields.values())
