"""The driver `canbus`: messages of a DBC file, received and sent."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import can

from micromanip.driver import (
    Answer,
    BusDriver,
    BusError,
    Channel,
    ConfigError,
    DeviceFault,
    Inbox,
    LinkError,
    Load,
    Steady,
    Task,
    Watchdog,
    worst_case_s,
)

from .database import Database, switches_bitrate
from .link import CanLink, LinkOptions
from .messages import ReceivedMessage, SentMessage
from .options import CanBusOptions
from .sniff import sniff
from .tables import MessageTables

_OPEN_NS = 900_000_000
_COUNTED = {"lost": "lost", "repeated": "doubled", "out_of_order": "late", "restarts": "restarts"}
"""Statistics, and what they are in a counter's record."""
_ECHOES = ("udp_multicast",)  # gives a sender its own frames, and can't tell


class CanBus(BusDriver):
    """Inputs and outputs are named "Message.Signal"; each message that is sent is a task."""

    Options: ClassVar[type[CanBusOptions]] = CanBusOptions

    def __init__(self, options: CanBusOptions, folder: Path) -> None:
        self.options = options
        self._file = folder / options.database
        self._database = Database(self._file)
        self._received: list[ReceivedMessage] = []
        self._sent: list[SentMessage] = []
        inputs: list[Channel] = []
        outputs: list[Channel] = []
        for name, received in options.receive.items():
            message = self._message(f"receive.{name}", name)
            self._received.append(ReceivedMessage(message, received, len(inputs), self._frame_s(message)))
            inputs += self._received[-1].inputs
        for name, sent in options.send.items():
            if name in options.receive:
                raise ConfigError(f"send.{name}: {name} is received already: a message has one sender")
            message = self._message(f"send.{name}", name)
            self._sent.append(SentMessage(message, sent, len(outputs), self._frame_s(message)))
            outputs += self._sent[-1].outputs
        if not inputs and not outputs:
            raise ConfigError("receive or send: at least one message must be given")
        self._inputs, self._outputs = tuple(inputs), tuple(outputs)
        self._by_identity = {message.identity: message for message in self._received}
        self._commands = {message.identity: message.name for message in self._sent}
        self._others = 0
        self._silence_ns = options.silence_ms * 1_000_000 if options.silence_ms and self._received else None
        self._heard_ns = 0
        self._tables: MessageTables | None = None
        self._link = CanLink(options, [*self._by_identity, *self._commands])

    @property
    def device(self) -> str:
        return self.options.device

    @property
    def files(self) -> Sequence[Path]:
        return (self._file,)

    @property
    def real_because(self) -> str | None:
        return self.options.real_because

    @property
    def silence(self) -> Watchdog | None:
        return self.options.watchdog

    @property
    def inputs(self) -> Sequence[Channel]:
        return self._inputs

    @property
    def outputs(self) -> Sequence[Channel]:
        return self._outputs

    @property
    def tasks(self) -> Sequence[Task]:
        return tuple(Task(message.name, message.rate_hz, message.indices) for message in self._sent)

    def loads(self) -> Sequence[Load]:
        frames = [(message.rate_hz, message.frame_s) for message in self._received]
        frames += [(message.rate_hz, message.frame_s) for message in self._sent]
        detail = " + ".join(f"{rate_hz:g} x {frame_s * 1e6:.0f} us" for rate_hz, frame_s in frames)
        share = sum(rate_hz * frame_s for rate_hz, frame_s in frames)
        return self._link.loads(share, detail, sum(rate_hz for rate_hz, _ in frames))

    def open(self) -> None:
        self._link.open()
        for message in self._received:
            if message.counter is not None:
                message.counter.forget()
        self._heard_ns = time.monotonic_ns()
        if self._tables is not None and (raw := self._link.raw_socket) is not None:
            self._tables.hold(*raw, self._heard_ns)
        if self._silence_ns is not None:
            self._listen(min(self._silence_ns, _OPEN_NS))

    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> None:  # noqa: ARG002
        if self._tables is not None:
            self._tables.complain(self._link)
        message = self._sent[task]
        self._link.send(message.frame(values))
        message.was_sent()

    def receive(self, inbox: Inbox, until_ns: int) -> None:
        by_identity = self._by_identity
        failure: BusError | None = None
        began_ns = time.monotonic_ns()
        frames = self._left() or self._link.receive(until_ns)
        for frame, time_ns in frames:
            message = by_identity.get((frame.arbitration_id, frame.is_extended_id))
            try:
                if message is None or frame.is_remote_frame:
                    self._take_other(frame)
                else:
                    message.take(frame.data, time_ns, inbox)
            except BusError as error:  # not before the frames after it have been taken
                failure = error
        self._watch(frames, began_ns)
        if failure is not None:
            raise failure

    def close(self) -> None:
        if self._tables is not None:
            self._tables.let_go()
        self._link.close()

    def steady(self) -> Steady | None:
        if not self._link.is_plain or not MessageTables.hold_all(self._received, self._sent):
            return None
        from . import exchange  # compiled: loaded only where it is going to be called

        tables = self._tables = MessageTables(self._received, self._sent, self.options.fd, self._silence_ns)
        receive, send = exchange.ENTRIES.addresses
        return Steady(receive, send, tables.record, lambda: tables.descriptor)

    def statistics(self) -> Mapping[str, int]:
        counters = [message.counter for message in self._received if message.counter]
        statistics = {**self._link.statistics(), "not_ours": self._others}
        if self._tables is not None:
            for name in ("frames_in", "frames_out", "not_ours"):
                statistics[name] += self._tables.counted(name)
        return {
            **statistics,
            **{name: sum(counter.counted(of) for counter in counters) for name, of in _COUNTED.items()},
            "short": sum(message.short for message in self._received),
        }

    def probe(self, seconds: float) -> Iterator[Answer]:
        return sniff(CanLink(self.options), self._database.by_identifier(), seconds)

    @classmethod
    def discover(cls, section: Mapping[str, Any], seconds: float) -> tuple[str, Iterator[Answer]]:
        options = LinkOptions.of(section)
        return options.device, sniff(CanLink(options), {}, seconds)

    def _listen(self, for_ns: int) -> None:
        """Wait for a first frame of the devices. Raises LinkError if none comes."""
        end_ns = self._heard_ns + for_ns
        while not self._are_ours(self._link.receive(end_ns)):
            if time.monotonic_ns() >= end_ns:
                raise self._silent(for_ns)

    def _left(self) -> list[tuple[can.Message, int]]:
        """Frames that the compiled functions left. Raises what their system calls came to."""
        if self._tables is None:
            return []
        self._heard_ns = max(self._heard_ns, self._tables.heard_ns)
        return self._tables.taken(self._link)

    def _watch(self, frames: Sequence[tuple[can.Message, int]], began_ns: int) -> None:
        """Note that `frames` came by a call that began then. Raises LinkError if the devices were silent for too long.

        Judged where a call begins: what came while this process stood still is there with the first call after that.
        """
        if self._are_ours(frames):
            self._heard_ns = time.monotonic_ns()
            if self._tables is not None:
                self._tables.heard_ns = self._heard_ns
        elif self._silence_ns is not None and began_ns - self._heard_ns > self._silence_ns:
            raise self._silent(self._silence_ns)

    def _are_ours(self, frames: Sequence[tuple[can.Message, int]]) -> bool:
        return any((frame.arbitration_id, frame.is_extended_id) in self._by_identity for frame, _ in frames)

    def _silent(self, for_ns: int) -> LinkError:
        names = ", ".join(message.title for message in self._received)
        return LinkError(
            f"{self.device}: nothing of {names} came for {for_ns * 1e-6:g} ms; is the device switched on, the cable "
            "plugged in, the bit rate right?"
        )

    def _take_other(self, frame: can.Message) -> None:
        """A frame that is not for us. Raises DeviceFault if it is one of our own commands, from somebody else."""
        self._others += 1
        name = self._commands.get((frame.arbitration_id, frame.is_extended_id))
        if name and frame.is_rx and not frame.is_remote_frame and self.options.interface not in _ECHOES:
            raise DeviceFault(f"somebody else sends {name} on {self.device}: two controllers, and one device")

    def _message(self, key: str, name: str) -> Any:
        message = self._database.message(key, name)
        if message.is_fd and not self.options.fd:
            raise ConfigError(f"{key}: {name} is a CAN FD message, and the bus is a classic one without data_bitrate")
        return message

    def _frame_s(self, message: Any) -> float:
        """How long a frame of the message keeps the bus at worst."""
        data_bitrate = None
        if message.is_fd:
            data_bitrate = self.options.data_bitrate if switches_bitrate(message) else self.options.bitrate
        return worst_case_s(message.length, self.options.bitrate, data_bitrate, message.is_extended_frame)
