"""A packet of the framing ``stream`` with so many blocks, as compiled code sees it: a frame whose last block counts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micromanip.driver.wire import FramePlan, GroupPlan

from .number import NumberCodec
from .packet_counter import PacketCounter
from .stream_options import Blocks, Stream


class StreamPacket:
    """Told from those with more or fewer blocks by their number, where the header has it."""

    first = 0

    def __init__(self, options: Stream, blocks: int, latency_ns: int, counter: PacketCounter | None) -> None:
        self._options, self._latency_ns = options, latency_ns
        self.samples, self.counter = blocks, counter
        self.kind = blocks if isinstance(options.blocks, Blocks) else None
        crc_size = options.crc.size if options.crc else 0
        self.length = options.header_bytes + blocks * options.block_bytes + crc_size

    def table(self) -> NDArray[np.void]:
        """Its frame, with the newest samples, and with what the device says of itself fixed. Raises ConfigError."""
        options = self._options
        last = options.header_bytes + (self.samples - 1) * options.block_bytes
        fields = {name: field.model_copy(update={"at": last + field.at}) for name, field in options.fields.items()}
        group = GroupPlan(fields, latency_ns=self._latency_ns)
        magic = bytes.fromhex(options.magic)
        frames = FramePlan(self.length, [group], magic, options.crc, options.counter, status=options.status).record()
        for known in options.identity.values():
            said = bytearray(known.end)
            NumberCodec(known).write(said, known.value)
            frames[0]["template"][known.at : known.end] = np.frombuffer(said[known.at :], np.uint8)
            frames[0]["fixed"][known.at : known.end] = 1
        return frames
