"""The black-box process: watches the loop's words, and puts each trip on disk whoever dies meanwhile.

Started by the host as ``python -m micromanip.host.trips.process`` in a session of its own. Standard input brings
the orders, then a line for each change of the configuration, and the host's word that the loop died;
standard output tells what became of each trip. It ends by itself once the loop has.
"""

from __future__ import annotations

import contextlib
import sys
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.bus.report import first_orders, send_message
from micromanip.errors import CheckFailed
from micromanip.faults import BY_NAME, LOOP_DIED, FaultReport, latched
from micromanip.host.shared_memory import CONTROL, RING, STATUS, RingReader, Segments
from micromanip.rt import mailbox as w

from .store import FORMAT, TripArchive, TripRecord

LOOP_DEATH = -1
"""The key of the trip that the loop's death is; every other trip has its number."""
BEFORE_S, AFTER_S = 2.0, 0.5
_COPIES = 50
_SPARE_ROWS = 100
_LOOK_S = 0.02
_PAGE = 4096
_CELL = ("configuration", "sha256", "path", "axes", "drivers", "period_ns")
"""What the orders say about the controller that is watched: it goes into each box."""


class Capture:
    """Reads control, status and ring; writes nothing."""

    def __init__(self, orders: dict[str, Any], control: Any, status: Any, ring: Any) -> None:
        self.configured(orders)
        self._control, self._status, self._ring = control, status, ring

    def configured(self, orders: dict[str, Any]) -> None:
        """The controller runs the configuration of these `orders` now."""
        self._cell = {key: orders[key] for key in _CELL}

    @property
    def cycles(self) -> int:
        """Cycles that the loop has run."""
        return int(self._status["words"][w.CYCLES_RUN])

    @property
    def finished(self) -> bool:
        """Whether the loop has ended by itself."""
        return bool(self._status["words"][w.FINISHED])

    @property
    def trips(self) -> int:
        """Faults that were latched so far: the number of the newest trip."""
        return int(self._status["words"][w.TRIPS])

    def tripped(self) -> TripRecord:
        """The box of the newest trip, with what the ring holds of the time before it."""
        state = self._state()
        rows = self._rows(since=int(state[0]["fault_cycle"]) - self._cycles(BEFORE_S))
        report = latched(state[0], self._cell["axes"], self._cell["drivers"])[-1]
        return self._box(report, rows, _first_faulty(rows, int(state[0]["fault"])), state)

    def died(self, report: FaultReport) -> TripRecord:
        """The box of a loop that ended without a word; `report` is what was seen of it."""
        state = self._state()
        rows = self._rows(since=int(state[0]["cycle"]) - self._cycles(BEFORE_S))
        return self._box(report, rows, len(rows) - 1, state)

    def is_over(self, box: TripRecord) -> bool:
        """Whether the time after the trip has passed, or will never pass."""
        return self.finished or int(self._status["words"][w.CYCLE]) >= box.trip["cycle"] + self._cycles(AFTER_S)

    def completed(self, box: TripRecord) -> TripRecord:
        """The same box with the cycles after the trip, and all sets of parameters that were in force."""
        known = int(box.rows["cycle"][-1]) if len(box.rows) else -1
        new = _between(self._rows(since=known), known + 1, box.trip["cycle"] + self._cycles(AFTER_S))
        rows = np.concatenate([box.rows, new])
        kept = np.concatenate([box.parameters, self._parameters(new)])
        _, first = np.unique(kept["version"], return_index=True)
        return replace(
            box, meta=box.meta | {"complete": True}, rows=rows, parameters=kept[first], events=_events(self._state())
        )

    def _cycles(self, seconds: float) -> int:
        return round(seconds * 1e9 / int(self._cell["period_ns"]))

    def _box(self, report: FaultReport, rows: NDArray[Any], at: int, state: NDArray[Any]) -> TripRecord:
        """The box of a trip in the row `at`; without any row it has only the state."""
        monotonic_ns = int(rows["time_ns"][at]) if len(rows) else time.monotonic_ns()
        cycle = int(rows["cycle"][at]) if len(rows) else int(state[0]["cycle"])
        utc_ns = time.time_ns() - (time.monotonic_ns() - monotonic_ns)
        meta = self._cell | {
            "format": FORMAT,
            "trip": report.document() | {"cycle": cycle, "number": report.kind.number, "message": str(report)},
            "complete": False,
            "utc": datetime.fromtimestamp(utc_ns * 1e-9, UTC).isoformat(timespec="milliseconds"),
            "utc_ns": utc_ns,
            "monotonic_ns": monotonic_ns,
        }
        rows = _between(rows, cycle - self._cycles(BEFORE_S), cycle + self._cycles(AFTER_S))
        return TripRecord(meta, rows, self._parameters(rows), state, _events(state))

    def _rows(self, since: int) -> NDArray[Any]:
        """All rows that the ring holds of the cycles from `since` on, and some before: a row is a cycle or more."""
        reader = RingReader(self._ring)
        passed = max(0, int(self._status["words"][w.CYCLE]) - since) + _SPARE_ROWS
        reader.position = max(0, reader.position - passed)
        return reader.read(len(self._ring["rows"]))

    def _parameters(self, rows: NDArray[Any]) -> NDArray[Any]:
        slots = self._control["parameters"]
        kept: NDArray[Any] = slots[
            np.isin(slots["version"], np.unique(rows["version"])) & (slots["version"] > 0)
        ].copy()
        return kept

    def _state(self) -> NDArray[Any]:
        """The loop's state between two cycles; from the middle of one where it is never still."""
        words, shared = self._status["words"], self._status["state"]
        state: NDArray[Any] = shared.copy()
        for _ in range(_COPIES):
            before = int(words[w.CYCLE])
            state = shared.copy()
            if state[0]["cycle"] == before == int(words[w.CYCLE]):
                break
        return state


def _between(rows: NDArray[Any], first: int, last: int) -> NDArray[Any]:
    """The rows of the cycles `first` to `last`."""
    cycles = np.ascontiguousarray(rows["cycle"])
    return rows[np.searchsorted(cycles, first) : np.searchsorted(cycles, last, "right")]


def _events(state: NDArray[Any]) -> NDArray[Any]:
    """The events that the loop still remembers, oldest first."""
    ring, count = state[0]["event"], int(state[0]["events"])
    newest: NDArray[Any] = ring[np.arange(max(0, count - len(ring)), count) % len(ring)].copy()
    return newest


def _first_faulty(rows: NDArray[Any], fault: int) -> int:
    """Where the latched fault was raised: the first row of the last stretch that has it."""
    other = np.flatnonzero(rows["fault"] != fault)
    return min(int(other[-1]) + 1, len(rows) - 1) if len(other) else 0


class Watch:
    """What the process has seen so far."""

    def __init__(self, capture: Capture, archive: TripArchive, known: int, stuck_s: float) -> None:
        self._capture, self._archive, self._stuck_s = capture, archive, stuck_s
        self._seen = known
        self._open: tuple[TripRecord, int] | None = None
        self._cycles, self._turned = -1, time.monotonic()
        self.over = False

    def resume(self, file: Path, key: int) -> None:
        """Complete the half of a box that a process before this one has left."""
        with contextlib.suppress(CheckFailed):  # somebody has removed it
            self._open = (TripRecord.load(file), key)

    def look(self, *, host_lives: bool) -> None:
        """Notice a trip, complete the one before; `over` once nothing more can come."""
        finished = self._capture.finished  # before the trips: while a box is saved the loop may latch one more, and end
        newest = self._capture.trips
        if newest > self._seen:
            self._complete()
            self._begin(self._capture.tripped(), newest)
            self._seen = newest
        if self._open is not None and self._capture.is_over(self._open[0]):
            self._complete()
        self._archive.retry()
        if self._capture.cycles != self._cycles:
            self._cycles, self._turned = self._capture.cycles, time.monotonic()
        if finished:
            self.over = True
        elif not host_lives and time.monotonic() - self._turned > self._stuck_s:
            self.died(FaultReport(LOOP_DIED))

    def died(self, report: FaultReport) -> None:
        """The loop is dead: what the ring holds is all there will be."""
        self._complete()
        self._begin(self._capture.died(report), LOOP_DEATH)
        self._complete()
        self.over = True

    def close(self) -> None:
        """A last try for everything that is not on disk yet."""
        self._complete()
        self._archive.give_up()

    def _begin(self, box: TripRecord, key: int) -> None:
        self._open = (box, key)
        self._archive.put(box, key)

    def _complete(self) -> None:
        if self._open is not None:
            box, key = self._open
            self._open = None
            self._archive.put(self._capture.completed(box), key)


def main() -> int:
    """Watch until the loop has ended."""
    told, orders = first_orders()
    if orders is None:
        return 0
    segments = Segments.attach(orders["descriptors"], writable=False)
    capture = Capture(
        orders, segments.control.record(CONTROL), segments.status.record(STATUS), segments.ring.record(RING)
    )
    archive = TripArchive(Path(orders["folder"]), orders["kept"], send_message)
    watch = Watch(capture, archive, orders["known"], orders["stuck_s"])
    if begun := orders["begun"]:
        watch.resume(Path(begun["file"]), begun["key"])
    segments.ring.bytes()[::_PAGE].max()  # map its pages now, not at the trip
    send_message(ready=True)
    while not watch.over:
        if told.ended:
            time.sleep(_LOOK_S)
        for message in told.within(_LOOK_S):
            if "configuration" in message:
                capture.configured(message)
            if "died" in message:
                watch.died(FaultReport(BY_NAME[message["died"]], what=message["what"], value=message["value"]))
        if not watch.over:
            watch.look(host_lives=not told.ended)
    watch.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
