"""The tables of the compiled functions, filled from the messages of a configuration; what goes over and comes back."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from micromanip.driver import ConfigError
from micromanip.driver.wire import MAX_BYTES, fill_number

from .binary_messages import SentFrame
from .frame_options import Crc, Length, Number
from .frame_parts import Incoming, PacketCounter
from .frame_reader import Chunk, FrameReader
from .framing import Silence
from .port import Port
from .records import CONTEXT, MAX_CHUNKS, MAX_MESSAGES, MAX_SYNC_BYTES


@dataclass(frozen=True)
class Heading:
    """How frames begin, by which number they are told apart, and how they end."""

    sync: bytes
    header_bytes: int
    kind: Number | None
    length: Length | None
    crc: Crc | None


class Tables:
    """The driver's record. What Python has of the line goes over by ``lend`` and comes back by ``take_back``."""

    def __init__(
        self, heading: Heading, received: Sequence[Incoming], sent: Sequence[SentFrame], silence: Silence
    ) -> None:
        """From now on the counters of the messages are kept in it. Raises ConfigError for what it has no room for."""
        self.record = np.zeros(1, CONTEXT)
        self._c = c = self.record[0]
        sync, crc = heading.sync, heading.crc
        if max(len(received), len(sent)) > MAX_MESSAGES or len(sync) > MAX_SYNC_BYTES:
            raise ConfigError("more messages, or sync bytes, than compiled code has room for")
        covered = crc.first + crc.size if crc else 0
        if min([one.length for one in received] + [one.length for one in sent]) < covered:
            raise ConfigError("a checksum that covers nothing")
        tables = [one.table()[0] for one in received], [one.table()[0] for one in sent]
        c["sync"][: len(sync)], c["sync_bytes"] = np.frombuffer(sync, np.uint8), len(sync)
        c["header_bytes"] = heading.header_bytes
        c["longest"] = max((message.length for message in received), default=0)
        fill_number(c["kind"], heading.kind)
        fill_number(c["length"], heading.length)
        c["plus"] = heading.length.plus if heading.length else 0
        c["silence_ns"] = silence.limit_ns if received else 0
        c["received_messages"], c["sent_messages"] = len(received), len(sent)
        counted: dict[PacketCounter, int] = {}
        for k, (row, message, table) in enumerate(zip(c["received"], received, tables[0], strict=False)):
            row["frame"], row["kind"], row["input"] = table, message.kind or 0, message.first
            row["samples"] = message.samples
            if message.counter is not None:
                if message.counter not in counted:
                    counted[message.counter] = k
                    message.counter.move_to(row["counter"])
                row["counted"], row["by_sample"] = counted[message.counter], message.counter.by_sample
        for row, out, table in zip(c["sent"], sent, tables[1], strict=False):
            row["frame"], row["output"] = table, out.first
            out.count_in(row)
        self._sent_messages = len(sent)
        self.forget()

    def forget(self) -> None:
        """The port is open no more: what came by it, and what went wrong, is over."""
        c = self._c
        c["descriptor"] = -1
        c["filled"] = c["chunks"] = c["unsent"] = c["left"] = c["receive_error"] = c["send_error"] = 0
        c["sent"]["unheard"] = 0

    @property
    def descriptor(self) -> int:
        """What to wait on; -1 where it is not open."""
        return int(self._c["descriptor"])

    def error(self, name: str) -> OSError | None:
        """What a system call of theirs came to: receive_error, send_error."""
        if not (number := int(self._c[name])):
            return None
        self._c[name] = 0
        return OSError(number, os.strerror(number))

    def counted(self, name: str) -> int:
        """What the compiled functions have counted since the last call: bytes_in, bytes_out, frames, more_lost."""
        count, self._c[name] = int(self._c[name]), 0
        return count

    def lend(self, reader: FrameReader, port: Port, silence: Silence, unheard: set[int]) -> None:
        """Compiled functions go on from here, as far as they can: what came and they have no room for stays."""
        c = self._c
        c["descriptor"], c["waiting_request"], c["heard_ns"] = port.descriptor, port.waiting_request, silence.since_ns
        chunks = reader.begun(MAX_BYTES, MAX_CHUNKS)
        c["left"] = chunks is None or bool(port.unsent)
        filled = 0
        for k, (data, time_ns) in enumerate(chunks or ()):
            c["buffer"][filled : filled + len(data)] = np.frombuffer(data, np.uint8)
            filled += len(data)
            c["chunk_end"][k], c["chunk_ns"][k] = filled, time_ns
        c["filled"], c["chunks"] = filled, len(chunks or ())
        for task, row in enumerate(c["sent"][: self._sent_messages]):
            row["unheard"] = task in unheard

    def take_back(self, reader: FrameReader, port: Port, silence: Silence, unheard: set[int]) -> None:
        """Python goes on from where they are."""
        c = self._c
        ends = [0, *c["chunk_end"][: c["chunks"]].tolist()]
        data = c["buffer"][: c["filled"]].tobytes()
        chunks: list[Chunk] = [
            (data[begin:end], int(time_ns))
            for begin, end, time_ns in zip(ends, ends[1:], c["chunk_ns"][: c["chunks"]], strict=False)
        ]
        reader.leave(chunks)
        c["filled"] = c["chunks"] = c["left"] = 0
        if c["unsent"]:
            port.unsent = c["frame"][c["frame_bytes"] - c["unsent"] : c["frame_bytes"]].tobytes()
            c["unsent"] = 0
        if c["silence_ns"]:
            silence.heard(int(c["heard_ns"]), more=True)
        unheard.clear()
        unheard.update(np.flatnonzero(c["sent"]["unheard"][: self._sent_messages]).tolist())
