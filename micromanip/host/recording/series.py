"""A recording without an end: files of some minutes each, of which the oldest go once all have reached a quota."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from .mcap_file import McapRecording


def numbered(file: Path, number: int) -> Path:
    """``night-0001.mcap`` of ``night.mcap``."""
    return file.with_name(f"{file.stem}-{number:04d}{file.suffix}")


class McapSeries:
    """As one recording: rows go on from file to file without a gap; each file is ended before the next begins."""

    def __init__(self, orders: Mapping[str, Any]) -> None:
        """`orders` have ``segment_s`` and ``quota_bytes``. Raises as `McapRecording`."""
        self._orders, self._quota = orders, int(orders["quota_bytes"])
        self._rows = max(1, round(orders["segment_s"] * 1e9 / orders["period_ns"]))
        self._closed: deque[tuple[Path, int]] = deque()
        self._before = self._lost = 0
        self._number = 1
        self._open()

    @property
    def file(self) -> Path:
        """The one that is being written."""
        return numbered(Path(self._orders["file"]), self._number)

    @property
    def written(self) -> int:
        """Rows so far, also those that have been removed again."""
        return self._before + self._current.written

    @property
    def size_bytes(self) -> int:
        """Size of all files that are there."""
        return sum(size for _, size in self._closed) + self._current.size_bytes

    def begin(self, state: Any, samples: NDArray[Any] | None = None) -> None:
        """Store a snapshot, and what the source `file` plays, in the first file."""
        self._current.begin(state, samples)

    def keep(self, state: Any) -> None:
        """Store a snapshot on the way in the file that is being written."""
        self._current.keep(state)

    def append(self, rows: NDArray[Any], slots: Any) -> None:
        """Add rows, and begin another file where this one has its share. Raises OSError as `McapRecording`."""
        while len(rows):
            if self._current.written >= self._rows:
                self._next(int(rows["cycle"][0]))
            room = self._rows - self._current.written
            self._current.append(rows[:room], slots)
            rows = rows[room:]
        self._remove_oldest()

    def note_lost(self, lost: int) -> None:
        """`lost` rows are missing so far, of all files."""
        self._lost = lost
        self._current.note_lost(lost)

    def mark(self, text: str, cycle: int, by: str, time_ns: int) -> None:
        """Somebody's remark, in the file that is being written."""
        self._current.mark(text, cycle, by, time_ns)

    def close(self) -> None:
        """End the last file."""
        self._current.close()

    def _open(self) -> None:
        self._current = McapRecording({**self._orders, "file": str(self.file)})
        self._current.note_lost(self._lost)

    def _next(self, cycle: int) -> None:
        self._current.close()
        self._closed.append((self.file, self._current.size_bytes))
        self._before += self._current.written
        self._number += 1
        self._open()
        self._current.go_on(cycle)

    def _remove_oldest(self) -> None:
        """The one that is being written stays, whatever the quota."""
        while self._closed and self.size_bytes > self._quota:
            oldest, _ = self._closed.popleft()
            oldest.unlink(missing_ok=True)
