"""What the scope shows, saved as a recording: rows as the loop wrote them, in the file that `run --record` makes."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, UsageError, system_error
from micromanip.recordings import file_header as header
from micromanip.replies import RunningConfiguration

from .cell import Source

_PART_ROWS = 1 << 16


async def save_recording(source: Source, configuration: RunningConfiguration, first: int, last: int, file: Path) -> int:
    """Write the cycles `first` to `last` into the new `file`; how many rows.

    Raises UsageError where some of them are not there row by row any more, CheckFailed where they are overwritten
    meanwhile, DeviceUnavailable without room.
    """
    history = source.history
    if first > last:
        raise UsageError("saving takes a first cycle that is not after the last one")
    first = max(first, history.oldest)
    if first < history.oldest_full:
        raise UsageError(
            f"a recording has every cycle, and those before cycle {history.oldest_full} are known as least and "
            "greatest only: zoom in; `micromanip recording start` records for longer"
        )
    orders = {
        "file": str(file),
        "axes": source.about["axes"],
        "period_ns": source.about["period_ns"],
        "configuration": configuration["text"],
        "sha256": configuration["sha256"],
    }
    try:
        recording = await asyncio.to_thread(_begun, orders)
    except OSError as problem:
        raise system_error(problem, file.parent) from problem
    try:
        written = await _write(recording, source, first, last)
        await asyncio.to_thread(recording.close)
    except OSError as problem:
        raise system_error(problem, file.parent) from problem
    return written


def _begun(orders: dict[str, Any]) -> Any:
    from micromanip.host.recording.mcap_file import McapRecording

    return McapRecording(orders)


async def _write(recording: Any, source: Source, first: int, last: int) -> int:
    """The oldest part first, so that none is overwritten before its turn."""
    at, begun = first, False
    while at <= last:
        if at < source.history.oldest_full:
            raise CheckFailed(f"cycle {at} was overwritten before it was saved: this computer is too slow")
        rows = source.history.rows(at, min(last, at + _PART_ROWS - 1))
        if len(rows):
            if not begun:  # brings what readers must know of the rows
                recording.mark(header.BEGAN, int(rows["cycle"][0]), "scope", int(rows["time_ns"][0]))
                begun = True
            await asyncio.to_thread(_append, recording, rows, source.parameters)
        at += _PART_ROWS
    if not begun:
        raise UsageError("nothing is known of these cycles")
    return int(recording.written)


def _append(recording: Any, rows: NDArray[Any], slots: NDArray[Any]) -> None:
    for part in np.array_split(rows, -(-len(rows) // 8192)):
        recording.append(part, slots)
