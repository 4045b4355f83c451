"""The driver ``line``: one device on a serial line, a TCP connection or UDP, with a framing that is configured."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from micromanip.driver import (
    Answer,
    BusDriver,
    BusError,
    Channel,
    ConfigError,
    Inbox,
    LinkError,
    Load,
    Outcome,
    Steady,
    StillOpening,
    Task,
    TransientError,
    Watchdog,
)

from .ascii import AsciiFraming
from .binary import BinaryFraming
from .framing import Framing, LineTime, Silence
from .options import LineOptions
from .port import Port
from .serial_port import SerialLine
from .stream import StreamFraming
from .tcp_port import TcpConnection, UdpDatagrams

_OPEN_NS = 900_000_000


class Line(BusDriver):
    """Channels have the names that the fields have in the configuration."""

    Options: ClassVar[type[LineOptions]] = LineOptions

    def __init__(self, options: LineOptions, folder: Path) -> None:  # noqa: ARG002 (it has no files)
        self._options = options
        self._port = _port(options)
        self._framing = _framing(options, self._port)
        speaks_hz = self._framing.speaks_hz
        if speaks_hz is not None and options.silence_ms < 2e3 / speaks_hz:
            raise ConfigError(
                f"silence_ms: {options.silence_ms:g} is less than two periods of what comes at {speaks_hz:g} Hz: the "
                "link would be lost again and again"
            )
        for kind, channels in (("input", self._framing.inputs), ("output", self._framing.outputs)):
            names = [channel.name for channel in channels]
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise ConfigError(f"two {kind}s are called {twice[0]}")

    @property
    def device(self) -> str:
        return self._port.name

    @property
    def silence(self) -> Watchdog | None:
        return self._options.watchdog

    @property
    def inputs(self) -> Sequence[Channel]:
        return self._framing.inputs

    @property
    def outputs(self) -> Sequence[Channel]:
        return self._framing.outputs

    @property
    def tasks(self) -> Sequence[Task]:
        return self._framing.tasks

    def loads(self) -> Sequence[Load]:
        return self._framing.loads

    def open(self) -> None:
        deadline_ns = time.monotonic_ns() + _OPEN_NS
        try:
            if self._port.descriptor < 0:  # else it was opened just now, and not ready yet
                self._port.open(deadline_ns)
            self._port.settle(deadline_ns)
            self._framing.begin(deadline_ns)
        except StillOpening:
            raise
        except TransientError as problem:  # there is no second try here: that is the worker's
            self._port.close()
            raise LinkError(str(problem)) from problem
        except BusError:
            self._port.close()
            raise

    def read_outputs(self) -> Sequence[float | None]:
        return self._framing.read_outputs()

    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> Outcome | None:
        return self._framing.perform(task, values, inbox)

    def receive(self, inbox: Inbox, until_ns: int) -> None:
        self._framing.receive(inbox, until_ns)

    def steady(self) -> Steady | None:
        return self._framing.steady()

    def close(self) -> None:
        self._framing.end()
        self._port.close()

    def statistics(self) -> Mapping[str, int]:
        return {**self._port.counters, **self._framing.counters}

    def probe(self, seconds: float) -> Iterator[Answer]:
        self._port.open(time.monotonic_ns() + _OPEN_NS)
        with contextlib.suppress(StillOpening):
            self._port.settle(self._port.opened_ns + self._port.settle_ns)
        yield from self._framing.probe(seconds)


def _port(options: LineOptions) -> Port:
    if options.serial is not None:
        return SerialLine(options.serial)
    if options.tcp is not None:
        return TcpConnection(options.tcp, options.silence_ms)
    assert options.udp is not None
    return UdpDatagrams(options.udp)


def _framing(options: LineOptions, port: Port) -> Framing:
    line_time, silence = LineTime(options.port), Silence(port.name, options.silence_ms)
    if options.binary is not None:
        return BinaryFraming(options.binary, port, line_time, silence)
    if options.ascii is not None:
        return AsciiFraming(options.ascii, port, line_time, silence)
    assert options.stream is not None
    return StreamFraming(options.stream, port, line_time, silence)
