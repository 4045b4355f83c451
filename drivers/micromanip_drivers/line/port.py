"""A port as the framings use it: opened, written to, read from, with errors by what is to be done about them."""

from __future__ import annotations

import errno
import fcntl
import select
import struct
import time
from abc import ABC, abstractmethod

from micromanip.driver import LinkError, StillOpening, TransientError

_COUNT = struct.Struct("i")
_STARTING_NS = 3_000_000_000
_AT_ONCE = 64
"""Reads that one call does at most: a babbling device must not keep the worker from writing."""


class Port(ABC):
    """Bytes to and from one device. `name` is what messages call it."""

    datagrams = False
    """True where each chunk that is received is whole, and has nothing to do with the one before."""
    largest = 65_536
    """Bytes that one reading takes at most."""
    settle_ns = 0
    """So long after opening nothing is sent: a board that is reset by it needs the time."""
    waiting_request = 0
    """``ioctl`` that asks the kernel for the bytes that it has taken and not sent yet; 0 where there is none."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.counters = {"bytes_in": 0, "bytes_out": 0, "transmit_full": 0}
        self._descriptor: int | None = None
        self.opened_ns = 0
        """When it was opened (CLOCK_MONOTONIC)."""
        self.unsent = b""
        """What the kernel has not taken yet of what was sent."""

    @property
    def descriptor(self) -> int:
        """What to wait on, -1 where it is not open."""
        return -1 if self._descriptor is None else self._descriptor

    @property
    def is_plain(self) -> bool:
        """Whether what is read from the descriptor, and written to it, is the device's, byte by byte."""
        return False

    def open(self, deadline_ns: int) -> None:
        """Reach it, until `deadline_ns` (CLOCK_MONOTONIC) at the latest. Raises LinkError."""
        self.close()
        try:
            self._descriptor = self._connect(deadline_ns)
        except OSError as problem:
            self.close()
            raise LinkError(f"{self.name} can't be opened: {said(problem)}") from problem
        self.opened_ns = time.monotonic_ns()

    def settle(self, until_ns: int) -> None:
        """Let the time pass that the device needs once its port is open, and forget what it said meanwhile.

        After a wait, until `until_ns` at most, StillOpening: called again, what follows has all its time. LinkError.
        """
        ready_ns = self.opened_ns + self.settle_ns
        if time.monotonic_ns() < ready_ns:
            while time.monotonic_ns() < min(ready_ns, until_ns):
                self.receive(min(ready_ns, until_ns))
            raise StillOpening(f"{self.name} is given {self.settle_ns * 1e-6:g} ms (settle_ms)")

    @property
    def may_be_starting(self) -> bool:
        """Whether it was opened so recently that a device which is reset by that may not be ready yet."""
        return time.monotonic_ns() - self.opened_ns < self.settle_ns + _STARTING_NS

    def close(self) -> None:
        """Let go of it; does no harm twice, never raises."""
        self._descriptor, self.unsent = None, b""
        self._disconnect()

    def send(self, data: bytes) -> None:
        """Hand `data` over, without waiting for it to be sent. Raises TransientError if it is full, LinkError.

        What is sent goes out whole: where the kernel takes a part of it, the rest follows as soon as it can. What
        waits already is not added to: values would grow old in a queue.
        """
        descriptor = self._opened()
        try:
            if self.unsent or self._waiting_bytes() >= len(data):
                self._flush()
                if self.unsent or self._waiting_bytes() >= len(data):
                    self._is_full()
            try:
                written = self._write(descriptor, data)
            except BlockingIOError:
                self._is_full()
            self.unsent = data[written:]
        except OSError as problem:
            raise self.gone("writing", problem) from problem
        self.counters["bytes_out"] += len(data)

    def receive(self, until_ns: int) -> list[tuple[bytes, int]]:
        """What came, each with the time of its reception (CLOCK_MONOTONIC, ns), oldest first.

        Returns soon after the first, and at `until_ns` at the latest. Raises LinkError.
        """
        descriptor = self._opened()
        chunks: list[tuple[bytes, int]] = []
        try:
            if self.unsent:
                self._flush()
            left_s = max(0.0, (until_ns - time.monotonic_ns()) * 1e-9)
            if not select.select([descriptor], [], [], left_s)[0]:
                return chunks
            while len(chunks) < _AT_ONCE:
                chunk = self._read(descriptor)
                if chunk is None:
                    break
                self.counters["bytes_in"] += len(chunk[0])
                chunks.append(chunk)
                if len(chunk[0]) < self.largest and not self.datagrams:
                    break  # that was all: asking again costs more than it would bring
        except BlockingIOError:
            pass
        except OSError as problem:
            if not chunks:  # else what came before that is good, and the next call finds it again
                raise self.gone("reading", problem) from problem
        return self._cleaned(chunks)

    @abstractmethod
    def _connect(self, deadline_ns: int) -> int:
        """The descriptor to wait on, non-blocking. Raises OSError."""

    @abstractmethod
    def _disconnect(self) -> None:
        """Free what `_connect` took."""

    @abstractmethod
    def _read(self, descriptor: int) -> tuple[bytes, int] | None:
        """One chunk and its time; None if there is no more now. Raises OSError, BlockingIOError."""

    @abstractmethod
    def _write(self, descriptor: int, data: bytes) -> int:
        """How many bytes the kernel took. Raises OSError, BlockingIOError."""

    def _waiting_bytes(self) -> int:
        """Bytes that the kernel has taken and not sent yet."""
        if not self.waiting_request:
            return 0
        count: int = _COUNT.unpack(fcntl.ioctl(self._opened(), self.waiting_request, bytes(_COUNT.size)))[0]
        return count

    def _cleaned(self, chunks: list[tuple[bytes, int]]) -> list[tuple[bytes, int]]:
        """What of it is from the device."""
        return chunks

    def _flush(self) -> None:
        if not self.unsent:
            return
        try:
            self.unsent = self.unsent[self._write(self._opened(), self.unsent) :]
        except BlockingIOError:
            return

    def _opened(self) -> int:
        if self._descriptor is None:
            raise LinkError(f"{self.name} is not open")
        return self._descriptor

    def _is_full(self) -> None:
        self.counters["transmit_full"] += 1
        raise TransientError(f"{self.name}: what was written before still waits to be sent; nothing was added to it")

    def gone(self, doing: str, problem: OSError) -> LinkError:
        """What the system said in "writing" or "reading", as a lost link."""
        return LinkError(f"{self.name} is gone ({doing}: {said(problem)})")


def said(problem: OSError) -> str:
    """What an error of the kernel says, in its own words or pyserial's."""
    if problem.strerror and problem.errno != errno.ENOMSG:
        return problem.strerror
    return " ".join(str(problem).split()) or type(problem).__name__
