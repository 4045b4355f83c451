"""The datagrams of a configuration: how long they are, and as tables, by which loop and Python read and write them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from micromanip.driver import ConfigError
from micromanip.driver.wire import (
    GOOD,
    FramePlan,
    GroupPlan,
    NumberCodec,
    begin_frame,
    judged,
    put_value,
    seal,
    status_of,
    value_of,
)
from micromanip_drivers.line.frame_parts import laid_out, mismatches, part

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
        own = GroupPlan(received.fields, latency_ns=round(received.latency_us * 1e3))
        slow = [
            GroupPlan(group.fields, group.counter, round(1e3 * (group.latency_us + received.latency_us)))
            for group in received.slow.values()
        ]
        head, crc = bytes.fromhex(received.head), options.crc
        counted = received.counter, received.clock, received.status, received.acknowledges
        self.received = FramePlan(self.received_bytes, [own, *slow], head, crc, *counted).record()[0]
        head = bytes.fromhex(sent.head)
        self.sent = FramePlan(self.sent_bytes, [GroupPlan(sent.fields)], head, crc, sent.counter).record()[0]
        """Both as tables, for the loop too."""

    @property
    def request(self) -> bytes:
        """What asks who it is."""
        assert self._options.identity is not None
        asked = bytes.fromhex(self._options.identity.request)
        return asked + (self._options.crc.of(asked) if self._options.crc else b"")

    def frame(self, values: Sequence[float], count: int) -> bytes:
        """A datagram with `values` of all outputs, which must be such as can be sent."""
        data = np.zeros(self.sent_bytes, np.uint8)
        begin_frame(self.sent, data, count)
        for number, value in zip(self.sent["number"], values, strict=False):
            put_value(self.sent, number, data, value)
        seal(self.sent, data)
        return data.tobytes()

    def is_answer(self, data: bytes) -> bool:
        """Whether it is the datagram that answers, undamaged."""
        return judged(self.received, data, len(data)) == GOOD

    def values(self, data: bytes) -> Mapping[str, float]:
        """What an answer says, by channel."""
        numbers = zip(self.inputs, self.received["number"], strict=False)
        return {name: float(value_of(self.received, number, data)) for name, number in numbers}

    def status(self, data: bytes) -> int:
        """0, or the device's word for what is wrong; -1 for a value that is no number."""
        return int(status_of(self.received, data)) or -int(not all(map(math.isfinite, self.values(data).values())))

    def says_who(self, data: bytes) -> bool:
        """Whether it is the datagram that answers the request for an identity."""
        identity, crc = self._options.identity, self._options.crc
        if identity is None or len(data) != self.identity_bytes or not data.startswith(bytes.fromhex(identity.head)):
            return False
        return crc is None or crc.fits(data)

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
