"""A board with sensors and amplifiers that speaks in binary frames, over whatever line."""

from __future__ import annotations

from functools import partial
from typing import Any

from micromanip.emulation.messages import Due
from micromanip.testbus.event_loop import EventLoop

from .binary_frame import FrameFormat, FrameLayout, FrameReader
from .device import Behind, LineDevice
from .device_line import DeviceLine
from .port import Peer


class BinaryBoard(LineDevice):
    """Sends its sensors at fixed rates, takes voltages as they come, answers what asks."""

    def __init__(self, loop: EventLoop, line: DeviceLine, behind: Behind, keys: Any) -> None:
        """`keys` are the driver's, `binary`: what the driver receives the board sends."""
        super().__init__(loop, line, behind)
        self._form, self._turnaround_ns = FrameFormat(keys), round(keys.turnaround_us * 1e3)
        self._who = None if keys.identity is None else Introduction(self._form, keys.identity)
        self.faults = ("identity",) if self._who else ()
        sent = {name: FrameLayout(self._form, name, each, each.fields) for name, each in keys.receive.items()}
        self._received: dict[int | None, tuple[FrameLayout, FrameLayout | None]] = {}
        for name, each in keys.send.items():
            layout = FrameLayout(self._form, name, each, each.fields)
            self._received[layout.kind] = (layout, sent.get(each.reply or ""))
        self._sizes = {kind: layout.size for kind, (layout, _) in self._received.items()}
        if self._who is not None and self._form.kind is not None:
            self._sizes[self._form.kind.code(self._who.request)] = len(self._who.request)
        self._counts: dict[str, int] = {}
        self._readers: dict[Peer, FrameReader] = {}
        self.signals = [behind.signal(channel) for layout in sent.values() for channel in layout.fields]
        replies = {each.reply for each in keys.send.values()}
        for name, layout in sent.items():
            if name not in replies:
                self.sends(Due(name, round(1e9 / keys.receive[name].rate_hz)), partial(self._send, layout))

    @property
    def description(self) -> str:
        out, into = len(self.periodic), len(self._received)
        return f"binary board, {out} message{'s' * (out != 1)} out, {into} in"

    def hear(self, data: bytes, peer: Peer) -> None:
        if not data:
            self._readers.pop(peer, None)
            return
        reader = self._readers.setdefault(peer, FrameReader(self._form, self._sizes.get))
        bad = reader.bad
        for frame in reader.feed(data):
            self._take(frame, peer)
        self.figures.not_understood += reader.bad - bad

    def reboot(self, for_s: float) -> None:
        super().reboot(for_s)
        self._counts.clear()
        self._readers.clear()

    def _take(self, frame: bytes, peer: Peer) -> None:
        if self._who is not None and frame == self._who.request:
            wrong, who = self._line.active("identity") is not None, self._who
            self._answer(peer, who.layout.built({name: number + wrong for name, number in who.values.items()}))
            return
        kind = self._form.kind.code(frame) if self._form.kind is not None else None
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
        ready_ns = self._loop.now_ns() + self._turnaround_ns
        self._loop.call_at(ready_ns, lambda: self._line.answer(peer, frame))

    def _send(self, layout: FrameLayout, message: Due) -> None:
        self._line.send(self._frame(layout, message.counted()))
        self.figures.sent += 1

    def _frame(self, layout: FrameLayout, count: int) -> bytes:
        return layout.built({name: self._behind.read(name) for name in layout.fields}, count)


class Introduction:
    """How the board says who it is."""

    def __init__(self, form: FrameFormat, keys: Any) -> None:
        self.layout = FrameLayout(form, "identity", keys, keys.numbers)
        self.values = {name: float(number.value) for name, number in keys.numbers.items()}
        self.request = form.sealed(bytes.fromhex(keys.request))
