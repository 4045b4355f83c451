"""The datagrams of a configuration: how long they are, as tables for the loop, and as plain Python for all else."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from micromanip.driver import ConfigError
from micromanip.driver.wire import FramePlan, GroupPlan, NumberCodec
from micromanip_drivers.line.frame_parts import InputNumber, OutputNumber, StatusWord, laid_out, mismatches, part

from .options import Identity, Received, Sent, UdpOptions

_MOST_COUNTER_BYTES = 4


class Datagrams:
    """What goes to and fro. Raises ConfigError for parts that overlap, or lie outside."""

    def __init__(self, options: UdpOptions) -> None:
        self._options = options
        received, sent = options.receive, options.send
        for key, counter in (("receive", received.counter), ("send", sent.counter)):
            if counter.size > _MOST_COUNTER_BYTES:
                raise ConfigError(f"{key}.counter.type: {counter.type} has more than 32 bits, which no counter needs")
        self.received_bytes = self._length("receive", received, _received_parts(received))
        self.sent_bytes = self._length("send", sent, _fields("fields", sent.fields))
        self.identity_bytes = 0
        if options.identity is not None:
            numbers = _fields("numbers", options.identity.numbers)
            self.identity_bytes = self._length("identity", options.identity, numbers)
        self.inputs = {
            name: field
            for fields in (received.fields, *(slow.fields for slow in received.slow.values()))
            for name, field in fields.items()
        }
        if len(self.inputs) < len(received.fields) + sum(len(slow.fields) for slow in received.slow.values()):
            raise ConfigError("receive.slow: a field of it has the name of another field")
        self._values = {name: InputNumber(field) for name, field in self.inputs.items()}
        self._outputs = [OutputNumber(name, field) for name, field in sent.fields.items()]
        self._counter = NumberCodec(sent.counter)
        self._status = StatusWord(received.status) if received.status is not None else None

    @property
    def received_plan(self) -> FramePlan:
        """For the loop."""
        received = self._options.receive
        own = GroupPlan(received.fields, latency_ns=round(received.latency_us * 1e3))
        slow = [
            GroupPlan(group.fields, group.counter, round(1e3 * (group.latency_us + received.latency_us)))
            for group in received.slow.values()
        ]
        return FramePlan(
            self.received_bytes,
            [own, *slow],
            bytes.fromhex(received.head),
            self._options.crc,
            received.counter,
            received.clock,
            received.status,
            received.acknowledges,
        )

    @property
    def sent_plan(self) -> FramePlan:
        """For the loop."""
        sent = self._options.send
        head = bytes.fromhex(sent.head)
        return FramePlan(self.sent_bytes, [GroupPlan(sent.fields)], head, self._options.crc, sent.counter)

    @property
    def request(self) -> bytes:
        """What asks who it is."""
        assert self._options.identity is not None
        asked = bytes.fromhex(self._options.identity.request)
        return self._sealed(bytearray(asked + bytes(self._options.crc.size if self._options.crc else 0)))

    def frame(self, values: Sequence[float], count: int) -> bytes:
        """A datagram with `values` of all outputs. Raises OutputRefused."""
        data = bytearray(self.sent_bytes)
        head = bytes.fromhex(self._options.send.head)
        data[: len(head)] = head
        self._counter.write(data, count)
        for number, value in zip(self._outputs, values, strict=True):
            number.put(data, value)
        return self._sealed(data)

    def is_answer(self, data: bytes) -> bool:
        """Whether it is the datagram that answers, undamaged."""
        return self._is(data, self.received_bytes, self._options.receive.head)

    def values(self, data: bytes) -> Mapping[str, float]:
        """What an answer says, by channel."""
        return {name: number.value(data) for name, number in self._values.items()}

    def status(self, data: bytes) -> int:
        """0, or the device's word for what is wrong; -1 for a value that is no number."""
        word = self._status.of(data) if self._status is not None else 0
        return word or (0 if all(map(math.isfinite, self.values(data).values())) else -1)

    def says_who(self, data: bytes) -> bool:
        """Whether it is the datagram that answers the request for an identity."""
        identity = self._options.identity
        return identity is not None and self._is(data, self.identity_bytes, identity.head)

    def mismatches(self, data: bytes) -> Sequence[str]:
        """What it says of its identity that is not as configured, in words."""
        return mismatches(self._known(), data)

    def identity(self, data: bytes) -> Mapping[str, float]:
        """What it says of its identity."""
        return {name: codec.read(data) for name, (codec, _) in self._known().items()}

    def _known(self) -> dict[str, tuple[NumberCodec, int]]:
        assert self._options.identity is not None
        numbers = self._options.identity.numbers
        return {name: (NumberCodec(known), known.value) for name, known in numbers.items()}

    def _length(self, key: str, section: Received | Sent | Identity, parts: list[tuple[str, int, int]]) -> int:
        head = len(bytes.fromhex(section.head))
        numbers = [] if isinstance(section, Identity) else part("counter", section.counter)
        crc = self._options.crc
        length = laid_out(key, [("head", 0, head), *numbers, *parts], section.bytes, crc.size if crc else 0)
        if crc is not None and crc.first > length - crc.size:
            raise ConfigError(
                f"crc.first: {crc.first} is behind the {length - crc.size} bytes of `{key}` that it can cover"
            )
        return length

    def _is(self, data: bytes, length: int, head: str) -> bool:
        return len(data) == length and data.startswith(bytes.fromhex(head)) and self._sealed(bytearray(data)) == data

    def _sealed(self, data: bytearray) -> bytes:
        crc = self._options.crc
        if crc is not None:
            data[-crc.size :] = crc.of(bytes(data[: -crc.size]))
        return bytes(data)


def _received_parts(received: Received) -> list[tuple[str, int, int]]:
    parts = [
        *part("acknowledges", received.acknowledges),
        *part("clock", received.clock),
        *part("status", received.status),
        *_fields("fields", received.fields),
    ]
    for name, slow in received.slow.items():
        parts += [*part(f"slow.{name}.counter", slow.counter), *_fields(f"slow.{name}.fields", slow.fields)]
    return parts


def _fields(key: str, fields: Mapping[str, object]) -> list[tuple[str, int, int]]:
    return [one for name, field in fields.items() for one in part(f"{key}.{name}", field)]  # type: ignore[arg-type]
