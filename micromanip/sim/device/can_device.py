"""A device with frames of its own on CAN: sends its sensors at fixed rates, takes its commands as they come."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from micromanip.sim.canbus.frame import Frame
from micromanip.sim.canbus.port import Node
from micromanip.sim.event_loop import EventLoop

from .amplifier import Amplifier
from .cell import PlayedCell
from .dbc_message import DbcMessage

MOST_BEHIND_NS = 50_000_000
"""A machine that is late makes up for it: frames come late, but each with its own sample and time. Not beyond this."""


class Bus(Protocol):
    """What carries the frames: the hub of the test bus, or an interface of python-can."""

    def attach(self, node: Node) -> None:
        """Let `node` take part."""

    def send(self, node: Node, frame: Frame, time_ns: int) -> bool:
        """Queue a frame that was ready at `time_ns`; False where it was lost."""


@dataclass
class Sent:
    """A message that the device sends."""

    message: DbcMessage
    period_ns: int
    signals: dict[str, str]
    """Signal of the DBC to signal of the cell."""
    count: int = 0
    counts_from_ns: float = 0
    """Until then its counter stands still."""
    silent_until_ns: float = 0
    due_ns: int = 0


@dataclass
class Figures:
    """Frames, since the start."""

    sent: int = 0
    received: int = 0
    not_sent: int = 0
    """Due while the queue was full, or the machine stalled."""
    not_understood: int = 0
    silent: int = 0
    """Due while it was switched off or silenced."""


class CanDevice:
    """Takes part in a bus from `start` on."""

    def __init__(
        self,
        loop: EventLoop,
        bus: Bus,
        cell: PlayedCell,
        sent: list[Sent],
        received: list[DbcMessage],
        outputs: dict[str, str],
        amplifier: Amplifier | None,
    ) -> None:
        """`outputs` are the plant's outputs by "Message.Signal"; signals that are not among them do nothing."""
        self.sent = sent
        self.figures = Figures()
        self._loop, self._bus, self._cell, self._amplifier = loop, bus, cell, amplifier
        self._received = {(message.identifier, message.extended): message for message in received}
        self._outputs = {
            message.name: {
                name: outputs[f"{message.name}.{name}"]
                for name in message.signals
                if f"{message.name}.{name}" in outputs
            }
            for message in received
        }
        self._off_until_ns = 0
        bus.attach(self)

    def start(self, now_ns: int) -> None:
        """Begin to send."""
        for sent in self.sent:
            sent.due_ns = now_ns + sent.period_ns
            self._schedule(sent)

    def on_frame(self, frame: Frame, time_ns: int) -> None:
        """Take a command into force at the end of its frame."""
        message = self._received.get((frame.identifier, frame.extended))
        if message is None or frame.remote or frame.error or time_ns < self._off_until_ns:
            return
        values = message.values(frame)
        if values is None:
            self.figures.not_understood += 1
            return
        self.figures.received += 1
        if self._amplifier is not None:
            commands = {output: values[name] for name, output in self._outputs[message.name].items()}
            self._amplifier.take(commands, time_ns)
            self._cell.advance_to(time_ns)

    def reboot(self, for_s: float) -> None:
        """Be off for a while, with the amplifier; its counters begin anew."""
        now_ns = self._loop.now_ns()
        self._off_until_ns = now_ns + round(for_s * 1e9)
        if self._amplifier is not None:
            self._amplifier.trip(now_ns)
        for sent in self.sent:
            sent.count = 0

    def _schedule(self, sent: Sent) -> None:
        self._loop.call_at(sent.due_ns, lambda: self._send(sent))

    def _send(self, sent: Sent) -> None:
        now_ns = self._loop.now_ns()
        if now_ns - sent.due_ns > MOST_BEHIND_NS:
            missed = (now_ns - sent.due_ns) // sent.period_ns
            self.figures.not_sent += missed
            sent.due_ns += missed * sent.period_ns
        self._cell.advance_to(sent.due_ns)
        if sent.due_ns < max(sent.silent_until_ns, self._off_until_ns):
            self.figures.silent += 1
        else:
            self._send_frame(sent)
        sent.due_ns += sent.period_ns
        self._schedule(sent)

    def _send_frame(self, sent: Sent) -> None:
        read = self._cell.read
        frame = sent.message.frame({name: read(signal) for name, signal in sent.signals.items()}, sent.count)
        if self._bus.send(self, frame, sent.due_ns):
            self.figures.sent += 1
        else:
            self.figures.not_sent += 1
        if sent.due_ns >= sent.counts_from_ns:
            sent.count += 1
