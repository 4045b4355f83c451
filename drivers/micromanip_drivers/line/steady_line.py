"""A line that compiled functions serve as long as frames follow each other, and Python where they don't."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.driver import ConfigError, Steady
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


class SteadyLine:
    """What compiled functions and Python hand over to each other; nothing where there are no such functions."""

    def __init__(self, reader: FrameReader, port: Port, silence: Silence) -> None:
        self._reader, self._port, self._silence = reader, port, silence
        self._c: Any = None
        self.unheard: set[int] = set()
        """Tasks whose outputs were sent, and nothing was heard of the device since."""
        self.frames = 0
        """Frames that compiled functions took."""
        self.more_lost = 0
        """Samples that they know to be missing, beyond one for each count that is."""

    def begin(self, heading: Heading, received: Sequence[Incoming], sent: Sequence[SentFrame]) -> Steady | None:
        """Have the functions go by tables of these; None where the port is none for them, or they have no room.

        From then on the counters of the messages are kept in their record.
        """
        if not self._port.is_plain:
            return None
        try:
            record = _filled(heading, received, sent)
        except ConfigError:
            return None
        from . import exchange  # compiled: loaded only where it is going to be called

        self._c = c = record[0]
        c["silence_ns"] = self._silence.limit_ns if received else 0
        self.forget()
        receive, send = exchange.ENTRIES.addresses
        return Steady(receive, send, record, lambda: int(c["descriptor"]))

    def forget(self) -> None:
        """The port is about to be closed, or was opened anew: what came by it, and what went wrong, is over."""
        self.unheard.clear()
        if (c := self._c) is not None:
            c["descriptor"] = -1
            c["filled"] = c["chunks"] = c["unsent"] = c["left"] = c["receive_error"] = c["send_error"] = 0
            c["sent"]["unheard"] = 0

    def lend(self) -> None:
        """Let them go on from where Python is, as far as they can: what came and they have no room for stays."""
        c, port = self._c, self._port
        if c is None:
            return
        c["descriptor"], c["waiting_request"] = port.descriptor, port.waiting_request
        c["heard_ns"] = self._silence.since_ns
        chunks = self._reader.begun(MAX_BYTES, MAX_CHUNKS)
        c["left"] = chunks is None or bool(port.unsent)
        filled = 0
        for k, (data, time_ns) in enumerate(chunks or ()):
            c["buffer"][filled : filled + len(data)] = np.frombuffer(data, np.uint8)
            filled += len(data)
            c["chunk_end"][k], c["chunk_ns"][k] = filled, time_ns
        c["filled"], c["chunks"] = filled, len(chunks or ())
        for task, row in enumerate(c["sent"][: c["sent_messages"]]):
            row["unheard"] = task in self.unheard

    @contextmanager
    def in_python(self, error: str, doing: str) -> Iterator[None]:
        """Go on from where they are, with what one of them met in `doing`, and let them go on."""
        if self._c is None:
            yield
            return
        self._take_back()
        number, self._c[error] = int(self._c[error]), 0
        try:
            if number:
                problem = OSError(number, os.strerror(number))
                raise self._port.gone(doing, problem) from problem
            yield
        finally:
            self.lend()

    def _take_back(self) -> None:
        c, port = self._c, self._port
        for name in ("bytes_in", "bytes_out"):
            port.counters[name] += int(c[name])
        self.frames, self.more_lost = self.frames + int(c["frames"]), self.more_lost + int(c["more_lost"])
        c["bytes_in"] = c["bytes_out"] = c["frames"] = c["more_lost"] = 0
        ends = [0, *c["chunk_end"][: c["chunks"]].tolist()]
        data = c["buffer"][: c["filled"]].tobytes()
        chunks: list[Chunk] = [
            (data[begin:end], int(time_ns))
            for begin, end, time_ns in zip(ends, ends[1:], c["chunk_ns"][: c["chunks"]], strict=False)
        ]
        self._reader.leave(chunks)
        c["filled"] = c["chunks"] = c["left"] = 0
        if c["unsent"]:
            port.unsent = c["frame"][c["frame_bytes"] - c["unsent"] : c["frame_bytes"]].tobytes()
            c["unsent"] = 0
        if c["silence_ns"]:
            self._silence.heard(int(c["heard_ns"]), more=True)
        self.unheard.clear()
        self.unheard.update(np.flatnonzero(c["sent"]["unheard"][: c["sent_messages"]]).tolist())


def _filled(heading: Heading, received: Sequence[Incoming], sent: Sequence[SentFrame]) -> NDArray[np.void]:
    """The record of the compiled functions. Raises ConfigError for what it has no room for."""
    record = np.zeros(1, CONTEXT)
    c = record[0]
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
    return record
