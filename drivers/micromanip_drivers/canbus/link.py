"""A CAN bus as the drivers use it: opened, sent to, received from, with errors by what is to be done about them.

Two ways lead to a bus. SocketCAN and the test bus have a socket to poll, and sending to it does not block: they are
read and written directly, in compiled turns too. All other interfaces of python-can are served by threads
(``threaded_bus.py``). Frames carry the time of their reception in CLOCK_MONOTONIC: the kernel's on SocketCAN, the bus's
own on the test bus, that of being read elsewhere.

The error frames of a CAN controller are counted, and bus-off is the end of the link. Only SocketCAN, and the test bus
that follows it, tell the kinds of error apart (linux/can/error.h). How well a bus does is judged by its frames: most
interfaces of python-can do not keep up their `state`.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import re
import select
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import can
from can.interfaces.socketcan import SocketcanBus

from micromanip.driver import BusError, LinkError, Load, StillOpening, TransientError

from ..line.serial_port import no_such_device
from . import socketcan, threaded_bus
from .options import LinkOptions
from .threaded_bus import Stuck, ThreadedBus

TRANSMIT_TIMEOUT = 0x001
CONTROLLER = 0x004
NO_ACKNOWLEDGE = 0x020
BUS_OFF = 0x040

# second byte of a frame about the controller
RECEIVE_OVERFLOW = 0x01
WARNING = 0x04 | 0x08
PASSIVE = 0x10 | 0x20

_TELL_APART = ("socketcan", "micromanip")


__all__ = ["CanLink", "LinkOptions"]

# What goes wrong comes as an exception: without this, python-can's log lines go to standard error as well.
logging.getLogger("can").addHandler(logging.NullHandler())

_FULL = (errno.ENOBUFS, errno.EAGAIN, errno.ENOMEM)
_GONE = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO, errno.EBADF, errno.EPIPE, errno.ECONNRESET, errno.ENOTCONN)
_WITH_ERRNO = ("socketcan", "micromanip")  # elsewhere error_code is the vendor's own number
_BUS_OFF = re.compile(r"bus.?off", re.IGNORECASE)
_PLAIN = {"socketcan": "the kernel", "micromanip": "the test bus"}
"""Interfaces with a descriptor to poll, to which sending does not block, and who stamps their frames."""
_DIRECT = (*_PLAIN, "virtual")  # the last is a queue within this process
_LIMIT = 128
"""Frames that one call takes at most: a babbling node must not keep the worker from sending."""


class CanLink:
    """One CAN bus.

    `identifiers` are the (identifier, extended) that are wanted; the kernel drops the others on SocketCAN. Other
    interfaces hand over all there is: some filter error frames away with the rest. None for all of them.
    """

    def __init__(self, options: LinkOptions, identifiers: Sequence[tuple[int, bool]] | None = None) -> None:
        self.options = options
        self._identifiers = identifiers
        self._bus: can.BusABC | None = None
        self._reader: socketcan.KernelReader | BusReader | ThreadedBus | None = None
        self._threads: ThreadedBus | None = None
        """Of an interface that is served by them: kept until its library has let go of the device."""
        self._errors = ErrorFrames(options.device, options.interface)
        self._counters = {"frames_in": 0, "frames_out": 0, "transmit_full": 0}
        self._before = {"overflows": 0, "bad_frames": 0}  # of the openings before

    def open(self) -> None:
        """Reach the bus. Raises LinkError, also for an interface, a library or a device that isn't there.

        StillOpening where a library takes its time: then it goes on, until ``close``.
        """
        if self._reader is None or self._reader is not self._threads:
            self.close()
            self._begin()
        if self._threads is not None and self._reader is self._threads:
            with self._explained():
                self._threads.reach()

    def open_fully(self) -> None:
        """The same, however long it takes."""
        while True:
            with contextlib.suppress(StillOpening):
                return self.open()

    @property
    def is_plain(self) -> bool:
        """Whether it has a socket of CAN frames as the kernel has them, for compiled turns."""
        return self.options.interface in _PLAIN

    def loads(self, share: float, detail: str, frames_per_s: float) -> list[Load]:
        """Of the bus, with the way in which it is served, and of that way where it has a limit of its own."""
        interface = self.options.interface
        if interface in _PLAIN:
            detail += f"; polled, stamped by {_PLAIN[interface]}"
        bus = Load(str(self.options.channel), share, detail)
        if interface in _DIRECT:
            return [bus]
        most = threaded_bus.FRAMES_PER_S_OF.get(interface, threaded_bus.FRAMES_PER_S)
        told = f"{frames_per_s:g} of {most:g} frames/s, stamped as they are read"
        return [bus, Load(f"threads for python-can's {interface}", frames_per_s / most, told)]

    def _begin(self) -> None:
        options = self.options
        arguments: dict[str, Any] = {"bitrate": options.bitrate, "fd": options.fd, **options.interface_options}
        if options.data_bitrate is not None:
            arguments["data_bitrate"] = options.data_bitrate
        if options.interface == "socketcan":
            if why := socketcan.trouble(str(options.channel), options.bitrate, options.data_bitrate):
                raise LinkError(f"{options.device}: {why}")
            arguments["can_filters"] = _filters(self._identifiers)
        if options.device.startswith("/") and not Path(options.device).exists():
            raise LinkError(f"{options.device} can't be opened: {no_such_device()}")
        # without python-can's own configuration files and environment variables: nothing is set behind our back
        opens = partial(can.Bus, options.channel, options.interface, ignore_config=True, **arguments)
        if options.interface not in _DIRECT:
            if self._threads is not None and not self._threads.is_gone:
                raise LinkError(f"{options.device}: python-can's {options.interface} has not let go of it yet")
            self._reader = self._threads = ThreadedBus(opens)
            return
        with self._explained():
            bus = self._bus = opens()
        self._reader = socketcan.KernelReader(bus.socket) if isinstance(bus, SocketcanBus) else BusReader(bus)

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        """What opening raises, as LinkError."""
        options = self.options
        try:
            yield
        except BusError as error:
            raise type(error)(f"{options.device}: {error}") from error
        except (can.CanInterfaceNotImplementedError, ImportError, NameError, AttributeError) as error:
            why = f"is the library of {options.interface} installed?"
            raise LinkError(f"{options.device} can't be opened: {_text(error)}; {why}") from error
        except Exception as error:  # whatever a library has to say; TypeError: an option that it doesn't take
            raise LinkError(f"{options.device} can't be opened: {_text(error)}") from error

    def close(self) -> None:
        """Let go of the bus; does no harm twice, never raises."""
        bus, reader = self._bus, self._reader
        self._bus = self._reader = None
        for name in self._before:
            self._before[name] += getattr(reader, name, 0)
        if isinstance(reader, ThreadedBus):
            reader.close()
        if bus is not None:
            with contextlib.suppress(Exception):
                bus.shutdown()

    def send(self, message: can.Message) -> None:
        """Hand a frame to the interface, without waiting. Raises TransientError if it is full, LinkError."""
        reader = self._reader
        if reader is None:
            raise LinkError(f"{self.options.device} is not open")
        try:
            if isinstance(reader, ThreadedBus):
                reader.send(message)
            elif self._bus is not None:
                self._bus.send(message, timeout=0)
        except Exception as error:  # whatever a library raises
            raise self.sorted("sending", error) from error
        self._counters["frames_out"] += 1

    def receive(self, until_ns: int) -> list[tuple[can.Message, int]]:
        """Frames that came, each with the time of its reception (CLOCK_MONOTONIC, ns), oldest first.

        Returns soon after the first, and at `until_ns` at the latest; error frames are counted, not returned. Raises
        LinkError for bus-off and for an interface that is gone.
        """
        while True:
            frames = self._taken(until_ns)
            frames = self.counted(frames)
            if frames or time.monotonic_ns() >= until_ns:
                return frames

    def counted(self, frames: list[tuple[can.Message, int]]) -> list[tuple[can.Message, int]]:
        """Those of `frames` that are none of error; all are counted. Raises LinkError for bus-off."""
        if any(message.is_error_frame for message, _ in frames):
            frames = self._without_errors(frames)
        self._counters["frames_in"] += len(frames)
        return frames

    @property
    def raw_socket(self) -> tuple[int, int] | None:
        """Descriptor of a socket of CAN frames as the kernel has them, and how many bytes of a time come before each.

        None where the interface has none, or it is not open.
        """
        if isinstance(self._reader, socketcan.KernelReader):
            return self._reader.fileno, 0
        stamp_bytes = getattr(self._bus, "packet_stamp_bytes", None)
        return None if self._bus is None or stamp_bytes is None else (self._bus.fileno(), stamp_bytes)

    def statistics(self) -> Mapping[str, int]:
        """Counters since ``__init__``."""
        counters = {**self._counters, **self._errors.counters}
        for name, before in self._before.items():
            counters[name] = counters.get(name, 0) + before + getattr(self._reader, name, 0)
        return counters

    def _taken(self, until_ns: int) -> list[tuple[can.Message, int]]:
        """What is there, or else what comes first until then; empty if it was nothing, or to be looked for again."""
        reader = self._reader
        if reader is None:
            raise LinkError(f"{self.options.device} is not open")
        try:
            left_s = (until_ns - time.monotonic_ns()) * 1e-9
            if left_s > 0.0:
                reader.wait(left_s)  # first: it returns at once if something is there, and costs less than to look
            return reader.drain(_LIMIT)
        except Exception as error:  # whatever a library raises
            raise self.sorted("receiving", error) from error

    def _without_errors(self, frames: list[tuple[can.Message, int]]) -> list[tuple[can.Message, int]]:
        for message, _ in frames:
            if message.is_error_frame:
                self._errors.take(message)
        return [frame for frame in frames if not frame[0].is_error_frame]

    def sorted(self, doing: str, error: Exception) -> BusError:
        """What python-can or the kernel raised in "sending" or "receiving", as an error of the bus."""
        what = f"{self.options.device}, {doing}: {_text(error)}"
        code = getattr(error, "errno", None)
        if code is None and self.options.interface in _WITH_ERRNO:
            code = getattr(error, "error_code", None)
        if isinstance(error, Stuck):
            return LinkError(f"{self.options.device}: {error}: does the adapter still read?")
        if doing == "sending" and (isinstance(error, BlockingIOError) or code in _FULL or "full" in str(error).lower()):
            self._counters["transmit_full"] += 1
            return TransientError(f"{what} (transmit buffer full)")
        if doing == "receiving" and isinstance(self._reader, ThreadedBus):
            return LinkError(what)
        if code in _GONE or not isinstance(error, can.CanError) or _BUS_OFF.search(str(error)):
            return LinkError(what)
        return TransientError(what)  # of a vendor's library: again and again, and it is a lost link


def _filters(identifiers: Sequence[tuple[int, bool]] | None) -> list[dict[str, Any]] | None:
    if identifiers is None:
        return None
    return [
        {"can_id": identifier, "can_mask": 0x1FFFFFFF if extended else 0x7FF, "extended": extended}
        for identifier, extended in identifiers
    ]


def _text(error: Exception) -> str:
    """One line of what happened."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return " ".join(str(error).split()) or type(error).__name__


class ErrorFrames:
    """Counters of what error frames reported."""

    def __init__(self, device: str, interface: str) -> None:
        self._device = device
        self._tells_apart = interface in _TELL_APART
        self.counters = dict.fromkeys(
            ("error_frames", "error_warning", "error_passive", "unacknowledged", "bus_off", "overflows"), 0
        )

    def take(self, message: can.Message) -> None:
        """Count an error frame. Raises LinkError if it says that the controller left the bus."""
        count = self.counters
        count["error_frames"] += 1
        if not self._tells_apart:
            return
        kind = message.arbitration_id
        if kind & BUS_OFF:
            count["bus_off"] += 1
            raise LinkError(f"bus-off on {self._device}: too many errors, check bit rates, wiring and terminators")
        if kind & (NO_ACKNOWLEDGE | TRANSMIT_TIMEOUT):
            count["unacknowledged"] += 1
        if kind & CONTROLLER and len(message.data) > 1:
            state = message.data[1]
            count["error_warning"] += bool(state & WARNING)
            count["error_passive"] += bool(state & PASSIVE)
            count["overflows"] += bool(state & RECEIVE_OVERFLOW)


class BusReader:
    """Frames of a python-can bus, each with the time of its reception in CLOCK_MONOTONIC.

    The time is that of being read: clocks of vendors' drivers start anywhere, drift, and some jump. The test bus alone
    stamps in CLOCK_MONOTONIC, and says so.
    """

    overflows = 0

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._fileno = _fileno(bus)
        self._first: list[tuple[can.Message, int]] = []  # what waiting for it has taken already
        self._stamped = getattr(bus, "timestamp_clock", None) == "CLOCK_MONOTONIC"

    def drain(self, limit: int) -> list[tuple[can.Message, int]]:
        """What is there, `limit` frames at most. Raises CanError, OSError."""
        receive, stamped = self._bus.recv, self._stamped
        frames, self._first = self._first, []
        while len(frames) < limit:
            message = receive(0)
            if message is None:
                break
            frames.append((message, _stamp_ns(message) if stamped else time.monotonic_ns()))
        if stamped and frames and frames[-1][1] > (now_ns := time.monotonic_ns()):
            return [(message, min(time_ns, now_ns)) for message, time_ns in frames]
        return frames

    def wait(self, seconds: float) -> None:
        """Until a frame is there, or so long."""
        if self._fileno is not None:
            select.select([self._fileno], [], [], seconds)
        elif (message := self._bus.recv(seconds)) is not None:
            self._first = [(message, _stamp_ns(message) if self._stamped else time.monotonic_ns())]


def _stamp_ns(message: can.Message) -> int:
    return round(message.timestamp * 1e9)


def _fileno(bus: can.BusABC) -> int | None:
    try:
        fileno = bus.fileno()
    except NotImplementedError:
        return None
    return fileno if fileno >= 0 else None
