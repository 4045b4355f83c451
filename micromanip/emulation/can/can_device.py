"""A device with frames of its own on CAN: sends its sensors at fixed rates, takes its commands as they come."""

from __future__ import annotations

from dataclasses import dataclass

from micromanip.emulation.amplifier import Amplifier
from micromanip.emulation.cell import EmulatedCell
from micromanip.emulation.messages import Due, MessageFigures, Periodic
from micromanip.testbus.bus import Bus
from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.frame import Frame

from .dbc_message import DbcMessage


@dataclass(kw_only=True)
class Sent(Due):
    """A message that the device sends."""

    message: DbcMessage
    signals: dict[str, str]
    """Signal of the DBC to signal of the cell."""


class CanDevice:
    """Takes part in a bus from `start` on."""

    def __init__(
        self,
        loop: EventLoop,
        bus: Bus,
        cell: EmulatedCell,
        sent: list[Sent],
        received: list[DbcMessage],
        outputs: dict[str, str],
        amplifier: Amplifier | None,
    ) -> None:
        """`outputs` are the plant's outputs by "Message.Signal"; signals that are not among them do nothing."""
        self.sent = sent
        self.figures = MessageFigures()
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
        self._periodic = [Periodic(loop, self.figures, message, cell.advance_to, self._send) for message in sent]
        bus.attach(self)

    @property
    def understood(self) -> int:
        """How many messages it takes."""
        return len(self._received)

    def start(self, now_ns: int) -> None:
        """Begin to send."""
        for periodic in self._periodic:
            periodic.start(now_ns)

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
            self._amplifier.take(commands, self._loop.now_ns())
            self._cell.advance_to(time_ns)

    def reboot(self, for_s: float) -> None:
        """Be off for a while, with the amplifier; its counters begin anew."""
        now_ns = self._loop.now_ns()
        self._off_until_ns = now_ns + round(for_s * 1e9)
        if self._amplifier is not None:
            self._amplifier.trip(now_ns)
        for periodic in self._periodic:
            periodic.off_until_ns = self._off_until_ns
            periodic.message.count = 0

    def _send(self, due: Due) -> None:
        assert isinstance(due, Sent)
        read = self._cell.read
        values = {name: read(signal) for name, signal in due.signals.items()}
        if self._bus.send(self, due.message.frame(values, due.counted()), due.due_ns):
            self.figures.sent += 1
        else:
            self.figures.not_sent += 1
