"""A board with sensors and amplifiers that speaks in binary frames, over whatever line."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from micromanip.emulation.messages import Due
from micromanip.testbus.event_loop import EventLoop

from .binary_frame import FrameFormat, FrameLayout, FrameReader
from .device import Behind, LineDevice
from .device_line import DeviceLine
from .faults import Identity
from .number import line_numbers, optional_number
from .port import Peer

_SAYS_WHO_EVERY_NS = 100_000_000


@dataclass(frozen=True)
class BoardIdentity:
    """How it says who it is: asked, or by itself now and then."""

    request: bytes | None
    layout: FrameLayout
    values: dict[str, float]


@dataclass(frozen=True)
class BoardMessages:
    """All that it speaks."""

    format: FrameFormat
    sent: list[tuple[FrameLayout, int]]
    """Those that come by themselves, each with its period, ns."""
    received: list[tuple[FrameLayout, FrameLayout | None]]
    """Those that it takes, each with the one that answers it."""
    identity: BoardIdentity | None
    turnaround_ns: int


class BinaryBoard(LineDevice):
    """Sends its sensors at fixed rates, takes voltages as they come, answers what asks."""

    def __init__(self, loop: EventLoop, line: DeviceLine, behind: Behind, messages: BoardMessages) -> None:
        super().__init__(loop, line, behind)
        self.faults = (Identity,) if messages.identity else ()
        self._messages = messages
        self._received = {layout.kind: (layout, reply) for layout, reply in messages.received}
        self._sizes = {kind: layout.size for kind, (layout, _) in self._received.items()}
        self._counts: dict[str, int] = {}
        self._readers: dict[Peer, FrameReader] = {}
        layouts = [layout for layout, _ in messages.sent] + [reply for _, reply in messages.received if reply]
        self.signals = [behind.signal(channel) for layout in layouts for channel in layout.fields]
        for layout, period_ns in messages.sent:
            self.sends(Due(layout.name, period_ns), partial(self._send, layout))

    @property
    def description(self) -> str:
        out, into = len(self._messages.sent), len(self._received)
        return f"binary board, {out} message{'s' * (out != 1)} out, {into} in"

    def start(self, now_ns: int) -> None:
        super().start(now_ns)
        if self._messages.identity is not None and self._messages.identity.request is None:
            self._say_who_now_and_then()

    def hear(self, data: bytes, peer: Peer) -> None:
        if not data:
            self._readers.pop(peer, None)
            return
        reader = self._readers.get(peer)
        if reader is None:
            identity = self._messages.identity
            request = identity.request if identity is not None else None
            sizes = dict(self._sizes)
            if request is not None and self._messages.format.kind is not None:
                sizes[self._messages.format.kind.code(request)] = len(request)
            reader = self._readers[peer] = FrameReader(self._messages.format, sizes.get)
        bad = reader.bad
        for frame in reader.feed(data):
            self._take(frame, peer)
        self.figures.not_understood += reader.bad - bad

    def reboot(self, for_s: float) -> None:
        super().reboot(for_s)
        self._counts.clear()
        self._readers.clear()

    def _take(self, frame: bytes, peer: Peer) -> None:
        identity, frame_format = self._messages.identity, self._messages.format
        if identity is not None and frame == identity.request:
            self._answer(peer, self._identity_frame(identity))
            return
        kind = frame_format.kind.code(frame) if frame_format.kind is not None else None
        layout, reply = self._received.get(kind, (None, None))
        if layout is None or len(frame) != layout.size:
            self.figures.not_understood += 1
            return
        self.figures.received += 1
        self._behind.write({name: number.get(frame) for name, number in layout.fields.items()})
        if reply is not None:
            self._behind.advance_to(self._loop.now_ns())
            count = self._counts.get(reply.name, 0)
            self._counts[reply.name] = count + 1
            self._answer(peer, self._frame(reply, count))
            self.figures.sent += 1

    def _answer(self, peer: Peer, frame: bytes) -> None:
        ready_ns = self._loop.now_ns() + self._messages.turnaround_ns
        self._loop.call_at(ready_ns, lambda: self._line.answer(peer, frame))

    def _send(self, layout: FrameLayout, message: Due) -> None:
        self._line.send(self._frame(layout, message.counted()))
        self.figures.sent += 1

    def _frame(self, layout: FrameLayout, count: int) -> bytes:
        return self._messages.format.built(layout, {name: self._behind.read(name) for name in layout.fields}, count)

    def _identity_frame(self, identity: BoardIdentity) -> bytes:
        wrong = self._line.active(Identity) is not None
        values = {name: number + wrong for name, number in identity.values.items()}
        return self._messages.format.built(identity.layout, values)

    def _say_who_now_and_then(self) -> None:
        identity = self._messages.identity
        assert identity is not None
        self._loop.call_at(self._loop.now_ns() + _SAYS_WHO_EVERY_NS, self._say_who_now_and_then)
        if self._loop.now_ns() >= self._off_until_ns:
            self._line.send(self._identity_frame(identity))


def board_messages(keys: Any) -> BoardMessages:
    """All that the section `binary` of the driver's options describes: what the driver receives the board sends."""
    frame_format = FrameFormat(
        sync=bytes.fromhex(keys.sync),
        length=optional_number(keys.length),
        length_plus=keys.length.plus if keys.length else 0,
        kind=optional_number(keys.kind),
        checksum=keys.crc,
    )
    sent = {name: _layout(name, message, frame_format) for name, message in keys.receive.items()}
    replies = {message.reply for message in keys.send.values()}
    received = [
        (_layout(name, message, frame_format), sent[message.reply] if message.reply else None)
        for name, message in keys.send.items()
    ]
    periodic = [
        (layout, round(1e9 / keys.receive[name].rate_hz)) for name, layout in sent.items() if name not in replies
    ]
    identity = None if keys.identity is None else _identity(keys.identity, frame_format)
    return BoardMessages(frame_format, periodic, received, identity, round(keys.turnaround_us * 1e3))


def _layout(name: str, message: Any, frame_format: FrameFormat) -> FrameLayout:
    fields = line_numbers(message.fields)
    counter, status = optional_number(message.counter), getattr(message, "status", None)
    status_number = optional_number(status)
    parts = [*fields.values(), *(part for part in (counter, status_number) if part is not None)]
    size = message.bytes or frame_format.size_at_end_of(parts)
    return FrameLayout(name, message.kind, size, counter, status_number, status.good[0] if status else 0, fields)


def _identity(keys: Any, frame_format: FrameFormat) -> BoardIdentity:
    fields = line_numbers(keys.numbers)
    size = keys.bytes or frame_format.size_at_end_of(list(fields.values()))
    layout = FrameLayout("identity", keys.kind, size, None, None, 0, fields)
    request = None
    if keys.request is not None:
        request = bytes.fromhex(keys.request)
        request += frame_format.checksum.of(request) if frame_format.checksum else b""
    return BoardIdentity(request, layout, {name: float(number.value) for name, number in keys.numbers.items()})
