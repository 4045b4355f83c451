"""A sensor that sends packets of samples by itself: a capacitive sensor over TCP, a laser tracker over UDP."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from micromanip.emulation.messages import Due
from micromanip.testbus.event_loop import EventLoop

from .binary_frame import LineNumber, line_numbers, optional_number
from .device import Behind, LineDevice
from .device_line import DeviceLine
from .port import Peer

CLOCK_BEGINS_S = 86_400.0
"""What the device's own clock says when it is switched on: nothing that anyone else's clock says."""
CLOCK_GAINS = 20e-6
"""It runs faster than the controller's, as two quartzes do."""
_PACKETS_PER_S = 1000
"""As many as a device sends at most where it may choose how many samples go into one."""


class PacketLayout:
    """A header, blocks with one sample of each field, and a checksum."""

    def __init__(self, keys: Any) -> None:
        """`keys` are the driver's, `stream`."""
        self._keys, self._magic = keys, bytes.fromhex(keys.magic)
        self._blocks = None if isinstance(keys.blocks, int) else LineNumber(keys.blocks)
        self._counter, self._status = optional_number(keys.counter), optional_number(keys.status)
        self._time = None if keys.time is None else LineNumber(keys.time, scale=keys.time.unit_s)
        self._identity = [(LineNumber(number), int(number.value)) for number in keys.identity.values()]
        self.fields = line_numbers(keys.fields)

    def built(self, samples: list[Mapping[str, float]], count: int, time_s: float, wrong: bool) -> bytes:
        """A packet of `samples`; `count` and `time_s` are those of the first, `wrong` is for somebody else's."""
        keys, header = self._keys, bytearray(self._keys.header_bytes)
        header[: len(self._magic)] = self._magic
        if self._blocks is not None:
            self._blocks.write(header, len(samples))
        if self._counter is not None:
            number = count if keys.counter.counts == "samples" else count // max(1, len(samples))
            self._counter.write(header, number % self._counter.counts)
        if self._time is not None:
            self._time.put(header, time_s)
        if self._status is not None:
            self._status.write(header, keys.status.good[0])
        for number_of, value in self._identity:
            number_of.write(header, value + wrong)
        packet = bytes(header) + b"".join(self._block(sample) for sample in samples)
        return packet + (keys.crc.of(packet) if keys.crc else b"")

    def _block(self, sample: Mapping[str, float]) -> bytes:
        block = bytearray(self._keys.block_bytes)
        for name, number in self.fields.items():
            number.put(block, sample[name])
        return bytes(block)


class StreamDevice(LineDevice):
    """Samples at a fixed rate and sends a packet whenever it is full."""

    def __init__(self, loop: EventLoop, line: DeviceLine, behind: Behind, name: str, keys: Any) -> None:
        """Its packets are called `name` in commands; `keys` are the driver's, `stream`.

        With `start` the device waits for these bytes before it sends any.
        """
        super().__init__(loop, line, behind)
        self.faults = ("identity",) if keys.identity else ()
        self._layout, self._samples, self._begin = PacketLayout(keys), _per_packet(keys), bytes.fromhex(keys.start)
        self.signals = [behind.signal(channel) for channel in self._layout.fields]
        self._sends = not self._begin
        self._heard = b""
        self._gathered: list[Mapping[str, float]] = []
        self._first_ns, self._clock_from_ns = 0, 0
        self._count = 0
        self.sends(Due(name, round(1e9 / keys.rate_hz)), self._sample)

    @property
    def description(self) -> str:
        rate_hz = 1e9 / self.periodic[0].message.period_ns
        return f"stream of {len(self.signals)} signals, {rate_hz:g} samples per second, {self._samples} a packet"

    def start(self, now_ns: int) -> None:
        self._clock_from_ns = now_ns
        super().start(now_ns)

    def hear(self, data: bytes, peer: Peer) -> None:  # noqa: ARG002
        self._heard = (self._heard + data)[-len(self._begin) - 1024 :]
        if not self._sends and self._begin in self._heard:
            self._sends = True
            self.figures.received += 1

    def reboot(self, for_s: float) -> None:
        super().reboot(for_s)
        self._sends = not self._begin
        self._gathered.clear()
        self._clock_from_ns = self._off_until_ns

    def _sample(self, message: Due) -> None:
        count = message.counted()
        if not self._gathered:
            self._first_ns, self._count = message.due_ns, count
        self._gathered.append({channel: self._behind.read(channel) for channel in self._layout.fields})
        if len(self._gathered) == self._samples:
            self._send()

    def _send(self) -> None:
        samples, self._gathered = self._gathered, []
        if not self._sends:
            self.figures.silent += 1
            return
        time_s = CLOCK_BEGINS_S + (self._first_ns - self._clock_from_ns) * 1e-9 * (1.0 + CLOCK_GAINS)
        wrong = self._line.active("identity") is not None
        self._line.send(self._layout.built(samples, self._count, time_s, wrong))
        self.figures.sent += 1


def _per_packet(keys: Any) -> int:
    """As configured; where the header tells it, so many that there are at most 1000 packets a second."""
    if isinstance(keys.blocks, int):
        return keys.blocks
    return int(min(keys.blocks.most, max(1, round(keys.rate_hz / _PACKETS_PER_S))))
