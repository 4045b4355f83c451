"""The recorder process: telemetry ring to HDF5 until its standard input is closed, or the disk takes no more.

Standard output tells the host how far it is, a JSON object a line: ``{"open": true}``, then ``rows`` (written so far)
and ``lost`` (overwritten in the ring before they were read); with ``problem`` where it had to end, and with
``complete`` where the file was closed in order.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import select
import signal
import sys
import time
from typing import Any

import numpy as np

from micromanip.host.ring import FILED_PARAMETERS, RingReader
from micromanip.host.shared_memory import CONTROL, RING, STATUS, Segments
from micromanip.rt.records import CELL_STATE
from micromanip.rt.telemetry import ROW

from .recording import COMPLETE, LOST, PARAMETERS, PROBLEM, ROWS, STATE

_PAUSE_S = 0.1
_TELL_S = 0.5
_CHUNK_ROWS = 1000
_BATCH_ROWS = 8192
_INDEX_BYTES = 65_536
"""More than the file's index grows by with a chunk."""
_PROBLEM_BYTES = 200
_NOT_RESERVABLE = (errno.EINVAL, errno.EOPNOTSUPP, errno.ENODEV, errno.ENOSYS)
"""What a file system says that knows no reservations."""


class Recording:
    """An open file and what has been put into it.

    Written so that a reader finds all rows up to the last flush however this ends: from `begin` on by HDF5's rules for
    one writer and many readers (what is pointed to is written before what points to it), and only into space
    that the disk has promised beforehand, because HDF5 does not survive a write that fails.
    """

    def __init__(self, orders: dict[str, Any]) -> None:
        """Raises OSError, also where the file exists already."""
        import h5py  # the extra "recording"

        self.file = h5py.File(orders["file"], "x", libver=("v110", "v110"))
        for name in ("configuration", "sha256", "axes", "period_ns"):
            self.file.attrs[name] = orders[name]
        self.file.attrs[LOST], self.file.attrs[COMPLETE] = 0, False
        self.file.attrs[PROBLEM] = np.array(b"", f"S{_PROBLEM_BYTES}")  # of fixed length: it is changed in its place
        self.rows = self.file.create_dataset(ROWS, (0,), ROW, maxshape=(None,), chunks=(_CHUNK_ROWS,))
        self.parameters = self.file.create_dataset(PARAMETERS, (0,), FILED_PARAMETERS, maxshape=(None,), chunks=(1,))
        self.versions: set[int] = set()
        self.lost = 0
        self._reserves = True

    def begin(self, state: Any) -> None:
        """Store the snapshot the rows follow."""
        self.file.create_dataset(STATE, data=np.array([state], CELL_STATE))
        self.file.swmr_mode = True

    def append(self, rows: Any, slots: Any) -> None:
        """Add rows; a new parameter version brings its parameters, one of `slots`, with it.

        Raises OSError where the disk takes no more; what came before is then in the file, and `close` still works.
        """
        if len(rows) == 0:
            return
        for version in np.unique(rows["version"]):
            if int(version) not in self.versions:  # an older one comes back where a promotion is taken back
                self.versions.add(int(version))
                self._extend(self.parameters, slots[slots["version"] == version].view(FILED_PARAMETERS))
        first = _CHUNK_ROWS - len(self.rows) % _CHUNK_ROWS
        try:
            for part in np.split(rows, range(first, len(rows), _CHUNK_ROWS)):  # a small disk takes one chunk, not two
                self._extend(self.rows, part)
        finally:
            self.file.flush()

    def note_lost(self, lost: int) -> None:
        """`lost` rows are missing so far."""
        if lost != self.lost:
            self.lost = lost
            self.file.attrs.modify(LOST, lost)

    def close(self, problem: str = "") -> None:
        """End the file in order; `problem` is why it ends early."""
        self.file.attrs.modify(PROBLEM, np.array(problem.encode()[:_PROBLEM_BYTES], f"S{_PROBLEM_BYTES}"))
        self.file.attrs.modify(COMPLETE, not problem)
        self.file.flush()
        self.file.close()

    def _extend(self, dataset: Any, values: Any) -> None:
        start = len(dataset)
        chunk = dataset.chunks[0]
        added = -(-(start + len(values)) // chunk) + (-start // chunk)  # chunks
        if added:
            self._reserve(added * chunk * dataset.dtype.itemsize + _INDEX_BYTES)
        dataset.resize((start + len(values),))
        try:
            dataset[start:] = values
            self.file.flush()
        except (OSError, RuntimeError):
            with contextlib.suppress(OSError, RuntimeError):
                dataset.resize((start,))  # or rows that were never written would be read as zeros
            raise

    def _reserve(self, size: int) -> None:
        """Let the disk promise `size` bytes behind the end. Raises OSError where it can't."""
        if not self._reserves:
            return
        try:
            os.posix_fallocate(self.file.id.get_vfd_handle(), self.file.id.get_filesize(), size)
        except OSError as problem:
            if problem.errno not in _NOT_RESERVABLE:
                raise
            self._reserves = False


def tell(**message: Any) -> None:
    """A line for the host, which may be dead: the file becomes complete all the same."""
    with contextlib.suppress(OSError):
        os.write(sys.stdout.fileno(), json.dumps(message).encode() + b"\n")


def main() -> int:
    """Record until standard input ends; 0 where all of it is in the file, 69 where nothing, 1 where a part of it is."""
    for number in (signal.SIGINT, signal.SIGTERM):  # sent to all processes of a service; the host ends this one
        signal.signal(number, signal.SIG_IGN)
    line = sys.stdin.readline()
    if not line:
        return 0  # the host died as it started us
    orders = json.loads(line)
    segments = Segments.attach(orders["descriptors"], writable=False)
    control, status = segments.control.record(CONTROL), segments.status.record(STATUS)
    reader = RingReader(segments.ring.record(RING))
    try:
        recording = Recording(orders)
    except ImportError:
        tell(problem="install the extra first: pip install micromanip[recording]")
        return 69
    except (OSError, RuntimeError) as problem:
        tell(problem=f"{orders['file']} can't be written: {_said(problem)}")
        return 69
    tell(open=True)
    first = int(sys.stdin.readline() or -1)
    try:
        _record(recording, reader, first, status, control)
    except (OSError, RuntimeError) as problem:  # h5py knows both
        return _give_up(recording, reader, _said(problem))
    rows = len(recording.rows)
    try:
        recording.close()
    except (OSError, RuntimeError) as problem:
        return _abandon(rows, reader.lost, _said(problem))
    tell(rows=rows, lost=reader.lost, complete=True)
    return 0


def _record(recording: Recording, reader: RingReader, first: int, status: Any, control: Any) -> None:
    recording.begin(status["snapshot"][0])
    running, told_s = True, 0.0
    while running:
        running = not select.select([sys.stdin], [], [], _PAUSE_S)[0]
        behind = True
        while behind:
            rows = reader.read(_BATCH_ROWS)
            recording.append(rows[rows["cycle"] > first], control["parameters"])
            recording.note_lost(reader.lost)
            behind = len(rows) == _BATCH_ROWS
        if time.monotonic() - told_s > _TELL_S:
            told_s = time.monotonic()
            tell(rows=len(recording.rows), lost=reader.lost)


def _give_up(recording: Recording, reader: RingReader, problem: str) -> int:
    """End in order after a write that failed, where HDF5 still can."""
    rows = -1
    try:
        rows = len(recording.rows)
        recording.note_lost(reader.lost)
        recording.close(problem)
    except (OSError, RuntimeError):
        return _abandon(rows, reader.lost, problem)
    tell(rows=rows, lost=reader.lost, problem=problem)
    return 1


def _abandon(rows: int, lost: int, problem: str) -> int:
    """Leave without HDF5, which would write, fail and crash once more at the end; the host mends the file."""
    tell(rows=rows, lost=lost, problem=problem, unclosed=True)
    os._exit(1)


def _said(problem: Exception) -> str:
    """HDF5's messages name every argument of the call; the system's word for it is enough."""
    number = getattr(problem, "errno", None)
    if number is None:
        text = str(problem)
        for candidate in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EIO, errno.EACCES, errno.EROFS, errno.EEXIST):
            if f"errno = {candidate}," in text:
                number = candidate
    return os.strerror(number) if number else " ".join(str(problem).split())[:_PROBLEM_BYTES]


if __name__ == "__main__":
    sys.exit(main())
