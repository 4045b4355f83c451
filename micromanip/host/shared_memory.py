"""The shared memory of one running controller: anonymous files, inherited by descriptor; and who reads the ring.

``memfd_create`` gives memory without a name: nothing is left behind after kill -9 of any process. A process that runs
already, and began to import before the host knew what to order, gets it with its one document on a socket that is its
standard input (SCM_RIGHTS, unix(7)).
"""

from __future__ import annotations

import json
import mmap
import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import DeviceUnavailable
from micromanip.rt.mailbox import CONTROL as CONTROL
from micromanip.rt.mailbox import RING as RING
from micromanip.rt.mailbox import RING_HEAD
from micromanip.rt.mailbox import SLOTS as SLOTS
from micromanip.rt.mailbox import STATUS as STATUS
from micromanip.rt.records import MAX_AXES
from micromanip.rt.telemetry import ROW

_BYTES, _DESCRIPTORS = 65_536, 253
"""Read at once; and the most that Linux lets go along."""


@dataclass(frozen=True)
class Segment:
    """One piece of shared memory and its descriptor."""

    descriptor: int
    memory: mmap.mmap

    @classmethod
    def create(cls, name: str, size: int) -> Segment:
        """New zeroed memory of `size` bytes; `name` shows in /proc only. DeviceUnavailable where there is none."""
        descriptor = os.memfd_create(name)
        try:
            os.fchmod(descriptor, 0o600)  # or whoever is handed a read-only one could open it again, for writing
            os.ftruncate(descriptor, max(size, 1))
            return cls(descriptor, mmap.mmap(descriptor, max(size, 1)))
        except OSError as problem:
            os.close(descriptor)
            raise DeviceUnavailable(
                f"{size / 1e6:.0f} MB of memory for {name}: {problem.strerror}; a limit may forbid it, "
                "`ulimit -a`, in a service LimitFSIZE or LimitAS"
            ) from problem

    @classmethod
    def attach(cls, descriptor: int, *, writable: bool) -> Segment:
        """Map inherited memory."""
        access = mmap.ACCESS_WRITE if writable else mmap.ACCESS_READ
        return cls(descriptor, mmap.mmap(descriptor, os.fstat(descriptor).st_size, access=access))

    def read_only(self) -> int:
        """A new descriptor on the same memory through which it can only be read; the caller closes it.

        The memory belongs to the controller's user, with mode 0600: whoever runs as another one can't reopen it.
        """
        return os.open(f"/proc/self/fd/{self.descriptor}", os.O_RDONLY | os.O_CLOEXEC)

    def record(self, dtype: np.dtype[Any]) -> Any:
        """The memory as one record of `dtype`."""
        return np.frombuffer(self.memory, dtype, 1)[0]

    def bytes(self) -> NDArray[np.uint8]:
        """The memory as plain bytes."""
        return np.frombuffer(self.memory, np.uint8)


@dataclass(frozen=True)
class Segments:
    """All segments of one controller, in the order in which their descriptors are handed on."""

    control: Segment
    status: Segment
    ring: Segment
    contexts: Segment
    samples: Segment

    @classmethod
    def create(cls, context_bytes: int, samples: NDArray[np.float64]) -> Segments:
        """Fresh memory for one run."""
        segments = cls(
            Segment.create("micromanip-control", CONTROL.itemsize),
            Segment.create("micromanip-status", STATUS.itemsize),
            Segment.create("micromanip-ring", RING.itemsize),
            Segment.create("micromanip-contexts", context_bytes),
            Segment.create("micromanip-samples", samples.nbytes),
        )
        segments.samples.bytes()[:] = np.ascontiguousarray(samples).view(np.uint8).ravel()
        return segments

    @property
    def descriptors(self) -> tuple[int, ...]:
        """Descriptors to pass to a child."""
        return tuple(s.descriptor for s in (self.control, self.status, self.ring, self.contexts, self.samples))

    @classmethod
    def attach(cls, descriptors: list[int], *, writable: bool) -> Segments:
        """Map the segments, the first of `descriptors`: writable in the loop process, for reading anywhere else."""
        return cls(*(Segment.attach(d, writable=writable) for d in descriptors[: len(fields(cls))]))

    def sample_table(self) -> NDArray[np.float64]:
        """Samples (n, MAX_AXES) of the reference source `file`."""
        return np.frombuffer(self.samples.memory, np.float64).reshape(-1, MAX_AXES)


def columns() -> list[str]:
    """How a row of the ring is laid out, a text for each field: two versions that agree in it read the same."""
    assert ROW.names is not None
    assert ROW.fields is not None
    return [f"{name} {ROW[name]} at {ROW.fields[name][1]}" for name in ROW.names]


def context_layout(sizes: list[int]) -> tuple[list[int], int]:
    """Offsets of the drivers' contexts, each on a cache line of its own, and the total size."""
    offsets, total = [], 0
    for size in sizes:
        offsets.append(total)
        total += -(-size // 64) * 64
    return offsets, total


class RingReader:
    """Follows the telemetry ring from where it is, in any process; the loop waits for no reader.

    Rows that were overwritten before they were read are counted.

    The loop publishes its head after a row is complete. A row is safe once, after the copy, the
    head is seen to be less than a whole ring further.
    """

    def __init__(self, ring: Any) -> None:
        self._words, self._rows = ring["words"], ring["rows"]
        self.position = int(self._words[RING_HEAD])
        self.lost = 0

    def read(self, most: int = 8192) -> NDArray[Any]:
        """Up to `most` new rows, oldest first; empty where there are none."""
        size = len(self._rows)
        head = int(self._words[RING_HEAD])
        start = max(self.position, head - size + 1)
        stop = min(head, start + most)
        begin, count = start % size, stop - start
        wrapped = max(0, begin + count - size)
        rows = np.concatenate([self._rows[begin : begin + count - wrapped], self._rows[:wrapped]])
        oldest_safe = int(self._words[RING_HEAD]) - size + 1
        torn = min(max(0, oldest_safe - start), len(rows))
        self.lost += start - self.position + torn
        self.position = stop
        kept: NDArray[Any] = rows[torn:]
        return kept

    def go_back(self, position: int, spare: int) -> None:
        """Begin with the row at `position`, or the oldest there is; `spare` of the oldest are left to the loop."""
        self.position = max(min(position, self.position), int(self._words[RING_HEAD]) - len(self._rows) + spare, 0)

    def latest(self) -> Any | None:
        """The newest row, without moving on; None before the first."""
        head = int(self._words[RING_HEAD])
        return self._rows[(head - 1) % len(self._rows)].copy() if head else None


def send_orders(wire: socket.socket, orders: Any, descriptors: Sequence[int]) -> None:
    """All orders that there will ever be; raises OSError where nobody is there to take them."""
    document = json.dumps(orders).encode()
    sent = socket.send_fds(wire, [document], list(descriptors))
    wire.sendall(document[sent:])
    wire.shutdown(socket.SHUT_WR)


def receive_orders(standard_input: int = 0) -> tuple[Any, list[int]]:
    """What the host handed on, as soon as it does: orders and descriptors. None where it ended, or let go, before."""
    with socket.socket(fileno=os.dup(standard_input)) as wire:
        document, descriptors, _, _ = socket.recv_fds(wire, _BYTES, _DESCRIPTORS)
        while more := wire.recv(_BYTES):
            document += more
    return (json.loads(document) if document else None), descriptors
