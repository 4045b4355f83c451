"""Messages of the framing ``binary``: frames to samples, values to frames."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.driver import Channel, ConfigError, Inbox
from micromanip.driver.wire import FramePlan, GroupPlan, NumberCodec

from .binary_options import Binary, BinaryIdentity, Received, Sent
from .frame_options import BAD, Counter, Status
from .frame_parts import (
    Incoming,
    InputNumber,
    OutputNumber,
    PacketCounter,
    Part,
    StatusWord,
    laid_out,
    mismatches,
    part,
)
from .framing import LineTime

_OTHERS_MOST = 256
"""Longest frame of a kind that we do not know: a damaged length must not swallow what follows."""


class Frames:
    """What all frames of a `binary` section have in common."""

    def __init__(self, options: Binary) -> None:
        self.options = options
        self.sync = bytes.fromhex(options.sync)
        self.crc_size = options.crc.size if options.crc else 0

    def length(self, key: str, message: Received | Sent | BinaryIdentity, parts: Sequence[Part]) -> int:
        """Of a message with these `parts` of its own. Raises ConfigError where they don't fit or overlap."""
        options = self.options
        if (message.kind is None) != (options.kind is None):
            raise ConfigError(f"{key}.kind: {'is missing' if options.kind else 'there is no binary.kind to put it in'}")
        if options.kind and message.kind is not None and message.kind > NumberCodec(options.kind).high:
            raise ConfigError(f"{key}.kind: {message.kind} does not fit into {options.kind.type}")
        frame = [("binary.sync", 0, len(self.sync)), *part("binary.length", options.length)]
        return laid_out(key, [*frame, *part("binary.kind", options.kind), *parts], message.bytes, self.crc_size)

    def sealed(self, frame: bytearray) -> bytes:
        """The frame with its checksum in place."""
        crc = self.options.crc
        if crc is not None:
            frame[-crc.size :] = crc.of(bytes(frame[: -crc.size]))
        return bytes(frame)

    def plan(self, length: int, group: GroupPlan, counter: Counter | None, status: Status | None = None) -> FramePlan:
        """One of them for compiled code."""
        return FramePlan(length, [group], self.sync, self.options.crc, counter, status=status)


class IdentityFrame:
    """The frame by which a device says who it is. Raises ConfigError."""

    def __init__(self, frames: Frames, options: BinaryIdentity) -> None:
        key = "binary.identity"
        parts = [one for name, known in options.numbers.items() for one in part(f"numbers.{name}", known)]
        self.length = frames.length(key, options, parts)
        self.kind = options.kind
        self.request = frames.sealed(bytearray(bytes.fromhex(options.request) + bytes(frames.crc_size)))
        self._numbers = {name: (NumberCodec(known), known.value) for name, known in options.numbers.items()}

    def mismatches(self, frame: bytes) -> Sequence[str]:
        """What it says that is not as configured, in words."""
        return mismatches(self._numbers, frame)

    def values(self, frame: bytes) -> dict[str, float]:
        """What it says."""
        return {name: codec.read(frame) for name, (codec, _) in self._numbers.items()}


class ReceivedFrame(Incoming):
    """A message that the device sends; its inputs begin at index `first`. Raises ConfigError."""

    def __init__(self, frames: Frames, name: str, options: Received, first: int, line_time: LineTime) -> None:
        key = f"binary.receive.{name}"
        fields = [one for label, field in options.fields.items() for one in part(f"fields.{label}", field)]
        parts = [*part("counter", options.counter), *part("status", options.status), *fields]
        self.name, self.kind, self.rate_hz = name, options.kind, options.rate_hz
        self.length = frames.length(key, options, parts)
        self.seconds = line_time.seconds(self.length)
        latency_s = self.seconds if options.latency_us is None else options.latency_us * 1e-6
        self._latency_ns = round(latency_s * 1e9)
        self.channels = [Channel(label, options.rate_hz, latency_s) for label in options.fields]
        self.first, self.samples = first, 1
        self._values = [InputNumber(field) for field in options.fields.values()]
        self._status = StatusWord(options.status) if options.status else None
        self.counter = PacketCounter(options.counter) if options.counter else None
        self._frames, self._options = frames, options

    def table(self) -> NDArray[np.void]:
        """Its frame for compiled code."""
        group = GroupPlan(self._options.fields, latency_ns=self._latency_ns)
        return self._frames.plan(self.length, group, self._options.counter, self._options.status).record()

    def take(self, frame: bytes, time_ns: int, inbox: Inbox) -> bool:
        """Put its samples into `inbox`; False if it is not a fresh one."""
        lost = self.counter.samples_before(frame) if self.counter else 0
        if lost is None:
            return False
        status = self.status(frame)
        taken_ns = time_ns - self._latency_ns
        for channel, number in enumerate(self._values, self.first):
            value = number.value(frame)
            inbox.put(channel, value, taken_ns, status if math.isfinite(value) else status or BAD, lost)
        return True

    def status(self, frame: bytes) -> int:
        """0, or the device's word for what is wrong."""
        return self._status.of(frame) if self._status else 0

    def values(self, frame: bytes) -> dict[str, float]:
        """What it says, by channel."""
        return {channel.name: number.value(frame) for channel, number in zip(self.channels, self._values, strict=True)}


class SentFrame:
    """A message that the device is sent; its outputs begin at index `first`. Raises ConfigError."""

    def __init__(self, frames: Frames, name: str, options: Sent, first: int, line_time: LineTime) -> None:
        key = f"binary.send.{name}"
        fields = [one for label, field in options.fields.items() for one in part(f"fields.{label}", field)]
        self.name, self.rate_hz = name, options.rate_hz
        self.length = frames.length(key, options, [*part("counter", options.counter), *fields])
        self.seconds = line_time.seconds(self.length)
        if options.fields:
            options.must_last(f"{key}.", options.rate_hz)
        latency_s = self.seconds if options.latency_us is None else options.latency_us * 1e-6
        self.channels = [
            Channel(label, options.rate_hz, latency_s, field.safe) for label, field in options.fields.items()
        ]
        self.first, self.indices = first, tuple(range(first, first + len(options.fields)))
        self._own = slice(first, first + len(options.fields))
        self._frames, self._options = frames, options
        self._empty = self._prepared(options)
        self._numbers = [OutputNumber(label, field) for label, field in options.fields.items()]
        self._counter = NumberCodec(options.counter) if options.counter else None
        self._counting = np.zeros(1, [("count", "i8")])[0]

    def frame(self, values: Sequence[float]) -> bytes:
        """The next frame, with `values` of all outputs of the driver. Raises OutputRefused.

        Its counter stays until `was_sent`: a frame that the port did not take leaves no gap.
        """
        data = bytearray(self._empty)
        for number, value in zip(self._numbers, values[self._own], strict=True):
            number.put(data, value)
        if self._counter is not None:
            self._counter.write(data, int(self._counting["count"]) % self._counter.counts)
        return self._frames.sealed(data)

    def was_sent(self) -> None:
        """The last frame is on its way: count on."""
        self._counting["count"] += 1

    def table(self) -> NDArray[np.void]:
        """Its frame for compiled code."""
        frames = self._frames.plan(self.length, GroupPlan(self._options.fields), self._options.counter).record()
        frames[0]["template"][: self.length] = np.frombuffer(self._empty, np.uint8)
        return frames

    def count_in(self, record: Any) -> None:
        """Keep the counter in `record` from now on, where compiled code goes on with it."""
        record["count"] = self._counting["count"]
        self._counting = record

    def _prepared(self, options: Sent) -> bytes:
        binary = self._frames.options
        data = bytearray(self.length)
        data[: len(self._frames.sync)] = self._frames.sync
        if binary.length is not None:
            said, codec = self.length - binary.length.plus, NumberCodec(binary.length)
            if not 0 <= said <= codec.high:
                raise ConfigError(
                    f"binary.send.{self.name}: its length, {self.length} bytes, is {said} in binary.length, "
                    f"which {binary.length.type} can't hold"
                )
            codec.write(data, said)
        if binary.kind is not None and options.kind is not None:
            NumberCodec(binary.kind).write(data, options.kind)
        return bytes(data)


class FrameKinds:
    """The frames that are known. Raises ConfigError for two that can't be told apart."""

    def __init__(self, options: Binary, received: Iterable[ReceivedFrame], identity: IdentityFrame | None) -> None:
        self._by_kind: dict[int | None, ReceivedFrame] = {}
        for message in received:
            if message.kind in self._by_kind:
                other = self._by_kind[message.kind].name
                why = "have the same kind" if options.kind else "cannot be distinguished without binary.kind"
                raise ConfigError(f"binary.receive.{message.name}: {other} and {message.name} {why}")
            self._by_kind[message.kind] = message
        self._lengths = {kind: message.length for kind, message in self._by_kind.items()}
        self.identity = identity
        if identity is not None:
            known = self._lengths.setdefault(identity.kind, identity.length)
            if identity.length > known:
                raise ConfigError(
                    f"binary.identity: its frame has {identity.length} bytes, that of the same kind in binary.receive "
                    f"has {known}"
                )
        self._kind = NumberCodec(options.kind) if options.kind else None
        self._length = NumberCodec(options.length) if options.length else None
        self._plus = options.length.plus if options.length else 0
        ends = [one.end for one in (options.kind, options.length) if one]
        self.header = max([len(options.sync.replace(" ", "")) // 2, *ends])
        crc_size = options.crc.size if options.crc else 0
        """Bytes that say of which kind a frame is, and how long."""
        self._shortest = self.header + crc_size
        self._longest = max([_OTHERS_MOST, *self._lengths.values()])

    def kind(self, frame: bytes | bytearray) -> int | None:
        """The number by which a frame is told; None where there is one kind only."""
        return int(self._kind.read(frame)) if self._kind else None

    def message(self, frame: bytes) -> ReceivedFrame | None:
        """The message that a frame is; None for another one."""
        return self._by_kind.get(self.kind(frame))

    def length(self, data: bytes | bytearray) -> int | None:
        """Of the frame that begins with `data`: 0 if it can't be one, None if that can't be said yet."""
        if len(data) < self.header:
            return None
        known = self._lengths.get(self.kind(data))
        if self._length is None:
            return known or 0
        said = int(self._length.read(data)) + self._plus
        if known is not None:
            return known if said == known else 0
        return said if self._shortest <= said <= self._longest else 0
