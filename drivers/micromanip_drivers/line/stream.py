"""The framing ``stream``: packets of samples, that come by themselves."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.driver import (
    Answer,
    Channel,
    ConfigError,
    Inbox,
    Load,
    Steady,
    Task,
    TransientError,
)
from micromanip.driver.wire import (
    DEVICE_CLOCK,
    MOST_BITS,
    FramePlan,
    GroupPlan,
    NumberCodec,
    forget_clock,
    taken_ns,
)

from .frame_options import BAD, overlap
from .frame_parts import Incoming, InputNumber, PacketCounter, StatusWord, mismatches, part
from .frame_reader import FrameReader, FrameSearch
from .framing import Framing, LineTime, Silence, Traffic
from .port import Port
from .steady_line import Heading, SteadyLine
from .stream_options import Blocks, Stream


class StreamFraming(Framing):
    """Inputs only."""

    outputs: Sequence[Channel] = ()
    tasks: Sequence[Task] = ()

    def __init__(self, options: Stream, port: Port, line_time: LineTime, silence: Silence) -> None:
        self._options, self._port, self._silence = options, port, silence
        _must_fit(options)
        self._crc_size = options.crc.size if options.crc else 0
        self._most = options.header_bytes + options.most_blocks * options.block_bytes + self._crc_size
        self._blocks = NumberCodec(options.blocks) if isinstance(options.blocks, Blocks) else None
        self._values = [InputNumber(field) for field in options.fields.values()]
        counter = options.counter
        self._counter = PacketCounter(counter, counter.counts == "samples") if counter else None
        self._status = StatusWord(options.status) if options.status else None
        self._identity = {name: (NumberCodec(known), known.value) for name, known in options.identity.items()}
        self._stamp = NumberCodec(options.time) if options.time else None
        self._clock = np.zeros(1, DEVICE_CLOCK)[0]
        if options.time:
            self._clock["unit_ns"], self._clock["bits"] = (
                1e9 * options.time.unit_s,
                min(8 * options.time.size, MOST_BITS),
            )
        self._magic = bytes.fromhex(options.magic)
        self._reader = FrameReader(port, FrameSearch(self._magic, self._length, options.crc))
        self._line = SteadyLine(self._reader, port, silence)
        self._period_ns = 1e9 / options.rate_hz
        packet_s = line_time.seconds(self._most)
        latency_s = packet_s if options.latency_us is None else options.latency_us * 1e-6
        self._latency_ns = round(latency_s * 1e9)
        self.inputs = [Channel(name, options.rate_hz / options.most_blocks, latency_s) for name in options.fields]
        self.loads: Sequence[Load] = line_time.loads([self._traffic(line_time)])
        self.speaks_hz = options.rate_hz / options.most_blocks
        self._packets = 0

    def begin(self, deadline_ns: int) -> None:
        self._forget()
        if self._options.start:
            self._port.send(bytes.fromhex(self._options.start))
        another = partial(mismatches, self._identity)
        self._silence.heard(self._reader.first(deadline_ns, another, "sends nothing"), more=True)
        self._line.lend()

    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> None:  # noqa: ARG002
        raise AssertionError("a stream has no tasks")

    def end(self) -> None:
        self._line.forget()

    def steady(self) -> Steady | None:
        options = self._options
        if options.time is not None:  # its clock is followed in Python
            return None
        blocks = options.blocks if isinstance(options.blocks, Blocks) else None
        counts = range(1, options.most_blocks + 1) if blocks else [options.most_blocks]
        packets = [StreamPacket(options, count, self._latency_ns, self._counter) for count in counts]
        heading = Heading(self._magic, options.header_bytes, blocks, None, options.crc)
        return self._line.begin(heading, packets, ())

    def receive(self, inbox: Inbox, until_ns: int) -> None:
        with self._line.in_python("receive_error", "reading"):
            self._receive(inbox, until_ns)

    def _receive(self, inbox: Inbox, until_ns: int) -> None:
        packets = self._reader.frames(until_ns)
        stranger = False
        for packet, time_ns in packets:
            if self._identity and mismatches(self._identity, packet):
                stranger = True
            elif self._take(packet, time_ns, inbox):
                self._silence.heard(time_ns, more=True)
        self._silence.check(packets[-1][1] if packets else time.monotonic_ns())
        self._reader.complain()
        if stranger:
            raise TransientError(f"{self._port.name}: a packet says that it is of another device")

    def probe(self, seconds: float) -> Iterator[Answer]:
        self._forget()
        if self._options.start:
            self._port.send(bytes.fromhex(self._options.start))
        return self._reader.all_of(self._described, (), seconds)

    @property
    def counters(self) -> Mapping[str, int]:
        return {
            "packets": self._packets + self._line.frames,
            **self._reader.counters,
            "lost": self._counter.lost + self._line.more_lost if self._counter else 0,
            "not_fresh": self._counter.stale if self._counter else 0,
            "restarts": self._counter.restarts if self._counter else 0,
            "clock_steps": int(self._clock["steps"]),
        }

    def _forget(self) -> None:
        self.end()
        self._reader.forget()
        if self._counter:
            self._counter.forget()
        forget_clock(self._clock)

    def _length(self, data: bytes | bytearray) -> int | None:
        """Of the packet that begins with `data`."""
        options = self._options
        if self._blocks is None:
            return self._most
        if len(data) < options.header_bytes:
            return None
        blocks = int(self._blocks.read(data))
        if not 1 <= blocks <= options.most_blocks:
            return 0
        return options.header_bytes + blocks * options.block_bytes + self._crc_size

    def _take(self, packet: bytes, time_ns: int, inbox: Inbox) -> bool:
        """Put the samples of a packet into `inbox`; False if it is not a fresh one."""
        options = self._options
        count = (len(packet) - options.header_bytes - self._crc_size) // options.block_bytes
        lost = self._counter.samples_before(packet, count) if self._counter else 0
        if lost is None:
            return False
        self._packets += 1
        status = self._status.of(packet) if self._status else 0
        first_ns = time_ns - self._latency_ns - round((count - 1) * self._period_ns)
        if self._stamp is not None:
            first_ns = int(taken_ns(self._clock, np.uint64(self._stamp.read(packet)), first_ns))
        for block in range(count):
            at = options.header_bytes + block * options.block_bytes
            at_ns = first_ns + round(block * self._period_ns)
            for channel, number in enumerate(self._values):
                value = number.value(packet, at)
                good = status if math.isfinite(value) else status or BAD
                inbox.put(channel, value, at_ns, good, 0 if block else lost)
        return True

    def _traffic(self, line_time: LineTime) -> Traffic:
        options = self._options
        if self._blocks is None:
            return Traffic("packets", options.rate_hz / options.most_blocks, line_time.seconds(self._most), "in")
        shortest = options.header_bytes + options.block_bytes + self._crc_size  # a packet for each sample costs most
        return Traffic("packets", options.rate_hz, line_time.seconds(shortest), "in")

    def _described(self, packet: bytes) -> Answer:
        inbox = Inbox()
        self._take(packet, time.monotonic_ns(), inbox)
        values: dict[str, Any] = {"bytes": len(packet)}
        values |= {name: codec.read(packet) for name, (codec, _) in self._identity.items()}
        if self._status:
            values["status"] = self._status.of(packet)
        values["lost"] = self._counter.lost if self._counter else 0
        values |= {self.inputs[sample.channel].name: sample.value for sample in inbox}
        return Answer(self._port.name, values, "; ".join(mismatches(self._identity, packet)))


def _must_fit(options: Stream) -> None:
    magic = bytes.fromhex(options.magic)
    parts = [("stream.magic", 0, len(magic)), *part("counter", options.counter), *part("status", options.status)]
    parts += part("time", options.time)
    parts += part("blocks", options.blocks) if isinstance(options.blocks, Blocks) else []
    parts += [one for name, known in options.identity.items() for one in part(f"identity.{name}", known)]
    if problem := overlap(parts):
        raise ConfigError(f"stream: {problem}")
    for name, _, end in parts:
        if end > options.header_bytes:
            raise ConfigError(f"stream: {name} ends behind the header, which has {options.header_bytes} bytes")
    fields = [one for name, field in options.fields.items() for one in part(f"fields.{name}", field)]
    if problem := overlap(fields):
        raise ConfigError(f"stream.fields: {problem}")


class StreamPacket(Incoming):
    """A packet with so many blocks as compiled code sees it: a frame whose last block counts.

    Told from those with more or fewer blocks by their number, where the header has it.
    """

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
