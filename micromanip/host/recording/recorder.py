"""The recorder process: telemetry ring to a file until its standard input is closed, or the disk takes no more.

Standard output tells the host how far it is, a JSON object a line: ``{"open": true}``, ``{"begun": true}`` once the
file has what the rows follow, then ``rows`` (written so far), ``bytes`` and
``lost`` (overwritten in the ring before they were read); with ``problem`` where it had to end, and with ``complete``
where the file was closed in order. What was opened and not begun leaves no file.
"""

from __future__ import annotations

import contextlib
import sys
import time
from typing import Any

from micromanip.bus.report import Orders, first_orders, send_message
from micromanip.host.shared_memory import CONTROL, RING, STATUS, RingReader, Segments

from .mcap_file import McapRecording

_TELL_S = 0.5
_BATCH_ROWS = 8192
_SPARE_ROWS = 2048
"""Of the ring's past so much may be overwritten while the first rows are read."""

_PAUSE_S = 0.05
"""Between two writes: as much as a kill costs, but for the time that writing takes."""


def main() -> int:
    """Record until standard input ends; 0 where all of it is in the file, 69 where nothing, 1 where a part of it is."""
    told, orders = first_orders()
    if orders is None:
        return 0
    segments = Segments.attach(orders["descriptors"], writable=False)
    reader = RingReader(segments.ring.record(RING))
    try:
        recording = McapRecording(orders)
    except OSError as problem:
        send_message(problem=f"{orders['file']} can't be written: {problem.strerror}")
        return 69
    send_message(open=True)
    first = told.next()
    if first is None:  # there was no snapshot to begin with
        _discard(recording)
        return 0
    played = segments.sample_table()
    try:
        recording.begin(segments.status.record(STATUS)["snapshot"][0], played if len(played) > 1 else None)
    except OSError as problem:
        send_message(problem=f"{orders['file']} can't be written: {problem.strerror}")
        _discard(recording)
        return 69
    send_message(begun=True)
    try:
        _record(recording, reader, told, _begin(orders, first, reader), segments)
        size = recording.size_bytes
        recording.close()
    except OSError as problem:  # what was written before it is whole
        send_message(rows=recording.written, lost=reader.lost, problem=problem.strerror)
        return 1
    send_message(rows=recording.written, bytes=size, lost=reader.lost, complete=True)
    return 0


def _begin(orders: dict[str, Any], first: int, reader: RingReader) -> int:
    """The cycle behind which the file begins: that of the snapshot, `first`, or where `reader` goes back to."""
    if before := round(orders.get("before_s", 0.0) * 1e9 / orders["period_ns"]):
        reader.go_back(orders.get("head", 0) - before, _SPARE_ROWS)
        return 0
    return first


def _record(recording: McapRecording, reader: RingReader, told: Orders, first: int, segments: Segments) -> None:
    control, status = segments.control.record(CONTROL), segments.status.record(STATUS)
    told_s, due_s = 0.0, time.monotonic()
    while not told.ended:
        now_s = time.monotonic()
        due_s = max(due_s + _PAUSE_S, now_s)  # what writing takes is no pause
        news = told.within(due_s - now_s)
        cycles = {each["state"] for each in news if "state" in each}
        state = status["snapshot"][0].copy() if cycles else None
        behind = True
        while behind:
            rows = reader.read(_BATCH_ROWS)
            recording.append(rows[rows["cycle"] > first], control["parameters"])
            recording.note_lost(reader.lost)
            behind = len(rows) == _BATCH_ROWS
        if state is not None and state["cycle"] in cycles:  # else another has come: this process is seconds behind
            recording.keep(state)
        for mark in (each for each in news if "text" in each):
            recording.mark(**mark)
        if time.monotonic() - told_s > _TELL_S:
            told_s = time.monotonic()
            progress = {"rows": recording.written, "bytes": recording.size_bytes, "lost": reader.lost}
            name = {"file": str(recording.file)} if recording.goes_on else {}
            send_message(**progress, **name)


def _discard(recording: McapRecording) -> None:
    """Take away the file that this process has made."""
    with contextlib.suppress(OSError):
        recording.file.unlink(missing_ok=True)


if __name__ == "__main__":
    sys.exit(main())
