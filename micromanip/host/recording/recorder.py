"""The recorder process: telemetry ring to a file until its standard input is closed, or the disk takes no more.

Standard output tells the host how far it is, a JSON object a line: ``{"open": true}``, ``{"begun": true}`` once the
file has what the rows follow, then ``rows`` (written so far), ``bytes``, ``armed`` (it waits for its trigger) and
``lost`` (overwritten in the ring before they were read); with ``problem`` where it had to end, and with ``complete``
where the file was closed in order. What was opened and not begun leaves no file.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from micromanip.extras import advice
from micromanip.host.orders import Orders, tell
from micromanip.host.ring import RingReader
from micromanip.host.shared_memory import CONTROL, RING, STATUS, Segments

from .hdf5_file import Hdf5Recording
from .mcap_file import McapRecording
from .series import McapSeries
from .window import Window

_TELL_S = 0.5
_BATCH_ROWS = 8192
_PROBLEM_BYTES = 200
_SPARE_ROWS = 2048
"""Of the ring's past so much may be overwritten while the first rows are read."""

Recording = Hdf5Recording | McapRecording | McapSeries


def main() -> int:
    """Record until standard input ends; 0 where all of it is in the file, 69 where nothing, 1 where a part of it is."""
    for number in (signal.SIGINT, signal.SIGTERM):  # sent to all processes of a service; the host ends this one
        signal.signal(number, signal.SIG_IGN)
    told = Orders(sys.stdin.fileno())
    orders = told.next()
    if orders is None:
        return 0  # the host died as it started us
    segments = Segments.attach(orders["descriptors"], writable=False)
    reader = RingReader(segments.ring.record(RING))
    try:
        recording = _opened(orders)
    except ImportError:
        tell(problem=f"h5py is missing: {advice('formats')}")
        return 69
    except (OSError, RuntimeError) as problem:
        tell(problem=f"{orders['file']} can't be written: {_said(problem)}")
        return 69
    tell(open=True)
    first = told.next()
    if first is None:  # there was no snapshot to begin with
        _discard(recording, orders, 0)
    played = segments.sample_table()
    try:
        recording.begin(segments.status.record(STATUS)["snapshot"][0], played if len(played) > 1 else None)
    except (OSError, RuntimeError) as problem:
        tell(problem=f"{orders['file']} can't be written: {_said(problem)}")
        _discard(recording, orders, 69)
    tell(begun=True)
    try:
        _record(recording, reader, told, _Wanted(orders, first), segments)
    except (OSError, RuntimeError) as problem:  # h5py knows both
        return _give_up(recording, reader, _said(problem))
    rows, size = recording.written, recording.size_bytes
    try:
        recording.close()
    except (OSError, RuntimeError) as problem:
        return _abandon(rows, reader.lost, _said(problem))
    tell(rows=rows, bytes=size, lost=reader.lost, armed=False, complete=True)
    return 0


def _opened(orders: Mapping[str, Any]) -> Recording:
    if not orders["file"].endswith(".mcap"):
        return Hdf5Recording(orders)
    return McapSeries(orders) if orders.get("segment_s") else McapRecording(orders)


class _Wanted:
    """From which cycle on, and which rows: as the host has ordered it."""

    def __init__(self, orders: Mapping[str, Any], first: int) -> None:
        """`first` is the cycle of the snapshot; without rows from before it the file goes on right behind it."""
        before, after = (round(orders.get(key, 0.0) * 1e9 / orders["period_ns"]) for key in ("before_s", "after_s"))
        self.window = Window(orders.get("triggers", ()), before, after)
        self.before, self.position = before, orders.get("head", 0) - before
        self.first = first if before == 0 else 0


def _record(recording: Recording, reader: RingReader, told: Orders, wanted: _Wanted, segments: Segments) -> None:
    control, status = segments.control.record(CONTROL), segments.status.record(STATUS)
    if wanted.before:
        reader.go_back(wanted.position, _SPARE_ROWS)
    window, told_s, newest = wanted.window, 0.0, wanted.first
    due_s = time.monotonic()
    while not (told.ended or window.is_over(newest)):
        now_s = time.monotonic()
        due_s = max(due_s + recording.pause_s, now_s)  # what writing takes is no pause
        news = told.within(due_s - now_s)
        for cycle in (each["state"] for each in news if "state" in each):
            state = status["snapshot"][0].copy()
            if state["cycle"] == cycle:  # else another one has come: this process is seconds behind
                window.keep(state)
        behind = True
        while behind:
            rows = reader.read(_BATCH_ROWS)
            newest = int(rows["cycle"][-1]) if len(rows) else newest
            for part in window.take(rows[rows["cycle"] > wanted.first]):
                recording.append(part, control["parameters"])
            for state in window.states():
                recording.keep(state)
            recording.note_lost(reader.lost)
            behind = len(rows) == _BATCH_ROWS
        for mark in (each for each in news if "text" in each):
            window.marked(mark["cycle"])
            recording.mark(**mark)
        if time.monotonic() - told_s > _TELL_S:
            told_s = time.monotonic()
            name = {"file": str(recording.file)} if isinstance(recording, McapSeries) else {}
            progress = {"rows": recording.written, "bytes": recording.size_bytes, "lost": reader.lost}
            tell(**progress, **name, armed=window.is_armed)


def _discard(recording: Recording, orders: Mapping[str, Any], code: int) -> NoReturn:
    """Take away the file that this process has made, and leave without HDF5, which would write to it once more."""
    file = recording.file if isinstance(recording, McapSeries) else Path(orders["file"])
    with contextlib.suppress(OSError):
        file.unlink(missing_ok=True)
    os._exit(code)


def _give_up(recording: Recording, reader: RingReader, problem: str) -> int:
    """End in order after a write that failed, where HDF5 still can."""
    rows = -1
    try:
        rows = recording.written
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
