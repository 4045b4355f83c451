"""The trend of one run of the controller: lines are made in the host, and written in a thread that may hang."""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
import time
from collections.abc import Callable
from datetime import datetime
from typing import Any

from micromanip.errors import system_error
from micromanip.host.state_directory import trend_folder
from micromanip.host.windows import Array
from micromanip.recordings.trend import MINUTE, SECOND, STEP_S
from micromanip.settings.check import Prepared
from micromanip.settings.schema.trend import Trend
from micromanip.status_reply import TrendKept

from .files import TrendFiles
from .summing import Summing, header

_WAITING_LINES = 600
"""Ten minutes in which a disk may stand still; later lines are missing."""
_END_S = 5.0


class TrendKeeper:
    """Takes rows, keeps their figures. What the disk refuses ends it, and is told once; it raises nothing."""

    def __init__(self, prepared: Prepared, wanted: Trend, say: Callable[[str], None]) -> None:
        """`say` gets a warning for people, from the thread of who calls `add`."""
        axes = list(prepared.configuration.axes)
        watched = [bool(axis["temperature_ok"]["signal"] >= 0) for axis in prepared.parameters[0]["axis"][: len(axes)]]
        self._folder = trend_folder(wanted, prepared.source.path)
        self._header, self._wanted, self._say = header(axes, watched), wanted, say
        self._summing = Summing(watched, prepared.configuration.loop.period_ns, self._put)
        self._lines: queue.Queue[tuple[str, str, str] | None] = queue.Queue(_WAITING_LINES)
        self._problem: OSError | None = None
        self._is_told = False
        self._newest = ""
        """When the newest row began that is in a file."""
        self._writer: threading.Thread | None = None

    def add(self, rows: Any, quantities: Array) -> None:
        """Take in rows as `Summing.add`."""
        if self._problem is None:
            self._summing.add(rows, quantities)
        else:
            self._tell()

    def report(self) -> TrendKept:
        """How far it is."""
        age_s = None
        if self._newest:
            age_s = time.time() - STEP_S[SECOND] - datetime.fromisoformat(f"{self._newest}+00:00").timestamp()
        message = None if self._problem is None else str(system_error(self._problem, self._folder))
        return {
            "folder": str(self._folder),
            "newest": self._newest or None,
            "age_s": None if age_s is None else round(max(0.0, age_s), 1),
            "message": message,
        }

    async def end(self) -> None:
        """Write what there is, unless the disk hangs."""
        self._summing.end()
        if self._writer is not None:
            with contextlib.suppress(queue.Full):
                self._lines.put_nowait(None)
            await asyncio.to_thread(self._writer.join, _END_S)
        self._tell()

    def _put(self, every: str, day: str, line: str) -> None:
        if self._writer is None:  # not before the host has left the loop's CPU: a thread stays where it was begun
            self._writer = threading.Thread(target=self._write, name="trend", daemon=True)
            self._writer.start()
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait((every, day, line))

    def _tell(self) -> None:
        if self._problem is not None and not self._is_told:
            self._is_told = True
            why = system_error(self._problem, self._folder)
            self._say(f"WARNING: {why}; no trend is kept any more until the next start")

    def _write(self) -> None:
        keep = {SECOND: self._wanted.keep_seconds_days, MINUTE: self._wanted.keep_days}
        try:
            files = TrendFiles(self._folder, self._header, keep, round(self._wanted.quota_MB * 1e6))
            with contextlib.closing(files):
                while (line := self._lines.get()) is not None:
                    files.append(*line)
                    every, _, text = line
                    if every == SECOND:
                        self._newest = text.partition(",")[0]
        except OSError as problem:
            self._problem = problem
