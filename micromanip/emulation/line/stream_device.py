"""A sensor that sends packets of samples by itself: a capacitive sensor over TCP, a laser tracker over UDP."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from micromanip.emulation.messages import Due
from micromanip.testbus.event_loop import EventLoop

from .device import Behind, LineDevice
from .device_line import DeviceLine
from .faults import Identity
from .number import LineNumber, line_numbers, optional_number
from .port import Peer

CLOCK_BEGINS_S = 86_400.0
"""What the device's own clock says when it is switched on: nothing that anyone else's clock says."""
CLOCK_GAINS = 20e-6
"""It runs faster than the controller's, as two quartzes do."""
_PACKETS_PER_S = 1000
"""As many as a device sends at most where it may choose how many samples go into one."""


@dataclass(frozen=True)
class PacketLayout:
    """A header, blocks with one sample of each field, and a checksum."""

    magic: bytes
    header_bytes: int
    block_bytes: int
    blocks: LineNumber | None
    """Where the header says how many there are."""
    counter: LineNumber | None
    counts_samples: bool
    time: LineNumber | None
    """`scale` is seconds a count."""
    status: LineNumber | None
    good_status: int
    identity: dict[str, tuple[LineNumber, float]]
    fields: dict[str, LineNumber]
    checksum: Any
    """The driver's keys of it; None without one."""

    def built(self, samples: list[Mapping[str, float]], count: int, time_s: float, wrong: bool) -> bytes:
        """A packet of `samples`; `count` and `time_s` are those of the first, `wrong` is for somebody else's."""
        header = bytearray(self.header_bytes)
        header[: len(self.magic)] = self.magic
        if self.blocks is not None:
            self.blocks.write(header, len(samples))
        if self.counter is not None:
            number = count if self.counts_samples else count // max(1, len(samples))
            self.counter.write(header, number % self.counter.counts)
        if self.time is not None:
            self.time.put(header, time_s)
        if self.status is not None:
            self.status.write(header, self.good_status)
        for number_of, value in self.identity.values():
            number_of.write(header, int(value) + wrong)
        packet = bytes(header) + b"".join(self._block(sample) for sample in samples)
        return packet + (self.checksum.of(packet) if self.checksum else b"")

    def _block(self, sample: Mapping[str, float]) -> bytes:
        block = bytearray(self.block_bytes)
        for name, number in self.fields.items():
            number.put(block, sample[name])
        return bytes(block)


class StreamDevice(LineDevice):
    """Samples at a fixed rate and sends a packet whenever it is full."""

    def __init__(
        self,
        loop: EventLoop,
        line: DeviceLine,
        behind: Behind,
        name: str,
        layout: PacketLayout,
        period_ns: int,
        samples: int,
        begin: bytes,
    ) -> None:
        """Its packets are called `name` in commands, and have `samples` each.

        With `begin` the device waits for these bytes before it sends any.
        """
        super().__init__(loop, line, behind)
        self.faults = (Identity,) if layout.identity else ()
        self.signals = [behind.signal(channel) for channel in layout.fields]
        self._layout, self._samples, self._begin = layout, samples, begin
        self._sends = not begin
        self._heard = b""
        self._gathered: list[Mapping[str, float]] = []
        self._first_ns, self._clock_from_ns = 0, 0
        self._count = 0
        self.sends(Due(name, period_ns), self._sample)

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
        wrong = self._line.active(Identity) is not None
        self._line.send(self._layout.built(samples, self._count, time_s, wrong))
        self.figures.sent += 1


def packet_layout(keys: Any) -> PacketLayout:
    """What the section `stream` of the driver's options describes."""
    return PacketLayout(
        magic=bytes.fromhex(keys.magic),
        header_bytes=keys.header_bytes,
        block_bytes=keys.block_bytes,
        blocks=None if isinstance(keys.blocks, int) else LineNumber(keys.blocks),
        counter=optional_number(keys.counter),
        counts_samples=keys.counter is not None and keys.counter.counts == "samples",
        time=None if keys.time is None else LineNumber(keys.time, scale=keys.time.unit_s),
        status=optional_number(keys.status),
        good_status=keys.status.good[0] if keys.status else 0,
        identity={name: (LineNumber(number), float(number.value)) for name, number in keys.identity.items()},
        fields=line_numbers(keys.fields),
        checksum=keys.crc,
    )


def samples_per_packet(keys: Any) -> int:
    """As configured; where the header tells it, so many that there are at most 1000 packets a second."""
    if isinstance(keys.blocks, int):
        return keys.blocks
    return int(min(keys.blocks.most, max(1, round(keys.rate_hz / _PACKETS_PER_S))))
