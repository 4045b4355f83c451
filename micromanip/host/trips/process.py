"""The black-box process: watches the loop's words, and puts each trip on disk whoever dies meanwhile.

Started by the host as ``python -m micromanip.host.trips.process`` in a session of its own. Standard input brings
the orders, then a line for each change of the configuration, and the host's word that the loop died;
standard output tells what became of each trip. It ends by itself once the loop has.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import sys
import time
from pathlib import Path
from typing import Any

from micromanip.errors import CheckFailed
from micromanip.host.shared_memory import CONTROL, RING, STATUS, Segments

from .box import Box
from .capture import Capture, Cell
from .store import file_name, prune

_LOOK_S = 0.02
_RETRY_S = 3.0
_KEPT_IN_MEMORY = 4
_PAGE = 4096


def tell(**message: Any) -> None:
    """A line for the host, which may be dead."""
    with contextlib.suppress(OSError):
        os.write(sys.stdout.fileno(), json.dumps(message).encode() + b"\n")


class Shelf:
    """Puts boxes on disk; what a full disk refuses is kept in memory, and tried again."""

    def __init__(self, folder: Path, kept: int) -> None:
        self.folder, self._kept = folder, kept
        self._waiting: dict[Path, tuple[Box, int]] = {}
        self._next_try = 0.0

    def put(self, box: Box, key: int) -> None:
        """Save `box`, or keep it for later; `key` is what the host knows the trip by."""
        trip = box.trip
        file = self.folder / file_name(box.meta["utc_ns"], trip["code"], trip["axis"])
        first = file not in self._waiting
        problem = self._save(file, box)
        if problem is None:
            self._waiting.pop(file, None)
            tell(key=key, file=str(file), code=trip["code"], complete=box.meta["complete"])
            return
        if first:
            tell(key=key, file=str(file), code=trip["code"], problem=problem)
        self._waiting[file] = (box, key)
        while len(self._waiting) > _KEPT_IN_MEMORY:
            self._lose(min(self._waiting), "more trips came than can be kept in memory")
        self._next_try = time.monotonic() + _RETRY_S

    def retry(self) -> None:
        """Try what is waiting again, every few seconds."""
        if self._waiting and time.monotonic() >= self._next_try:
            self.flush()

    def flush(self) -> None:
        """Try what is waiting again, now."""
        for box, key in list(self._waiting.values()):
            self.put(box, key)

    def give_up(self) -> None:
        """A last try; what can't be written even now is lost."""
        self.flush()
        for file in list(self._waiting):
            self._lose(file, "the controller ended before it could be written")

    def _lose(self, file: Path, why: str) -> None:
        box, key = self._waiting.pop(file)
        tell(key=key, file=str(file), code=box.trip["code"], lost=why)

    def _save(self, file: Path, box: Box) -> str | None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            box.save(file)
            prune(self.folder, self._kept)
        except OSError as problem:
            return problem.strerror or str(problem)
        return None


class Watch:
    """What the process has seen so far."""

    def __init__(self, capture: Capture, shelf: Shelf, known: int, stuck_s: float) -> None:
        self._capture, self._shelf, self._stuck_s = capture, shelf, stuck_s
        self._seen = known
        self._open: tuple[Box, int] | None = None
        self._cycles, self._turned = -1, time.monotonic()
        self.over = False

    def resume(self, file: Path, key: int) -> None:
        """Complete the half of a box that a process before this one has left."""
        with contextlib.suppress(CheckFailed):  # somebody has removed it
            self._open = (Box.load(file), key)

    def look(self, *, host_lives: bool) -> None:
        """Notice a trip, complete the one before; `over` once nothing more can come."""
        newest = self._capture.trips
        if newest > self._seen:
            self._complete()
            self._begin(self._capture.tripped(), newest)
            self._seen = newest
        if self._open is not None and self._capture.is_over(self._open[0]):
            self._complete()
        self._shelf.retry()
        if self._capture.cycles != self._cycles:
            self._cycles, self._turned = self._capture.cycles, time.monotonic()
        if self._capture.finished:
            self.over = True
        elif not host_lives and time.monotonic() - self._turned > self._stuck_s:
            self.died(None)

    def died(self, message: str | None) -> None:
        """The loop is dead: what the ring holds is all there will be."""
        self._complete()
        self._begin(self._capture.died(message), -1)
        self._complete()
        self.over = True

    def close(self) -> None:
        """A last try for everything that is not on disk yet."""
        self._complete()
        self._shelf.give_up()

    def _begin(self, box: Box, key: int) -> None:
        self._open = (box, key)
        self._shelf.put(box, key)

    def _complete(self) -> None:
        if self._open is not None:
            box, key = self._open
            self._open = None
            self._shelf.put(self._capture.completed(box), key)


def main() -> int:
    """Watch until the loop has ended."""
    for number in (signal.SIGINT, signal.SIGTERM):  # the loop's end is ours, too
        signal.signal(number, signal.SIG_IGN)
    lines = open(sys.stdin.fileno(), "rb", buffering=0, closefd=False)  # noqa: SIM115
    first = lines.readline()
    if not first:
        return 0  # the host died as it started us
    orders = json.loads(first)
    segments = Segments.attach(orders["descriptors"], writable=False)
    capture = Capture(
        _cell(orders), segments.control.record(CONTROL), segments.status.record(STATUS), segments.ring.record(RING)
    )
    watch = Watch(capture, Shelf(Path(orders["folder"]), orders["kept"]), orders["known"], orders["stuck_s"])
    if begun := orders["begun"]:
        watch.resume(Path(begun["file"]), begun["key"])
    segments.ring.bytes()[::_PAGE].max()  # map its pages now, not at the trip
    tell(ready=True)
    host_lives = True
    while not watch.over:
        if not host_lives:
            time.sleep(_LOOK_S)
        elif select.select([lines], [], [], _LOOK_S)[0]:
            line = lines.readline()
            host_lives = bool(line)
            message = json.loads(line) if line else {}
            if "configuration" in message:
                capture.cell = _cell(message)
            if "died" in message:
                watch.died(message["died"])
                break
        watch.look(host_lives=host_lives)
    watch.close()
    return 0


def _cell(orders: dict[str, Any]) -> Cell:
    return Cell(
        configuration=orders["configuration"],
        sha256=orders["sha256"],
        path=orders["path"],
        axes=tuple(orders["axes"]),
        drivers=tuple(orders["drivers"]),
        period_ns=int(orders["period_ns"]),
    )


if __name__ == "__main__":
    sys.exit(main())
