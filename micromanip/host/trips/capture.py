"""Noticing a trip in the shared memory, and taking what belongs to it out of the telemetry ring."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.host.messages import FAULTS, LOOP_DIED, advice, code_of, fault_message
from micromanip.host.ring import RingReader
from micromanip.rt import mailbox as w

from .box import FORMAT, Box

BEFORE_S, AFTER_S = 2.0, 0.5
_COPIES = 50
_SPARE_ROWS = 100


@dataclass(frozen=True)
class Cell:
    """What the orders say about the controller that is watched."""

    configuration: str
    sha256: str
    path: str
    axes: tuple[str, ...]
    drivers: tuple[str, ...]
    period_ns: int


class Capture:
    """Reads control, status and ring; writes nothing."""

    def __init__(self, cell: Cell, control: Any, status: Any, ring: Any) -> None:
        self.cell = cell
        self._control, self._status, self._ring = control, status, ring

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

    def tripped(self) -> Box:
        """The box of the newest trip, with what the ring holds of the time before it."""
        state = self._state()
        rows = self._rows(since=int(state[0]["fault_cycle"]) - self._cycles(BEFORE_S))
        fault, axis = int(state[0]["fault"]), int(state[0]["fault_axis"])
        at = _first_faulty(rows, fault)
        value, limit = float(state[0]["fault_value"]), float(state[0]["fault_limit"])
        name = self.cell.axes[axis] if axis >= 0 else None
        trip = {
            "code": FAULTS[fault].code,
            "number": fault,
            "axis": name,
            "value": value if math.isfinite(value) else None,
            "limit": limit if math.isfinite(limit) else None,
            "message": fault_message(fault, name, value, limit, self.cell.drivers),
        }
        return self._box(trip, rows, at, state)

    def died(self, message: str | None) -> Box:
        """The box of a loop that ended without a word; `message` is what the host saw of it."""
        state = self._state()
        rows = self._rows(since=int(state[0]["cycle"]) - self._cycles(BEFORE_S))
        said = message or f"{LOOP_DIED.code} {LOOP_DIED.what.format(how='died')}. {advice(LOOP_DIED)}"
        trip = {"code": code_of(said), "number": None, "axis": None, "value": None, "limit": None, "message": said}
        return self._box(trip, rows, len(rows) - 1, state)

    def is_over(self, box: Box) -> bool:
        """Whether the time after the trip has passed, or will never pass."""
        return self.finished or int(self._status["words"][w.CYCLE]) >= box.trip["cycle"] + self._cycles(AFTER_S)

    def completed(self, box: Box) -> Box:
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
        return round(seconds * 1e9 / self.cell.period_ns)

    def _box(self, trip: dict[str, Any], rows: NDArray[Any], at: int, state: NDArray[Any]) -> Box:
        """The box of a trip in the row `at`; without any row it has only the state."""
        monotonic_ns = int(rows["time_ns"][at]) if len(rows) else time.monotonic_ns()
        cycle = int(rows["cycle"][at]) if len(rows) else int(state[0]["cycle"])
        utc_ns = time.time_ns() - (time.monotonic_ns() - monotonic_ns)
        meta = {
            "format": FORMAT,
            "trip": trip | {"cycle": cycle},
            "complete": False,
            "utc": datetime.fromtimestamp(utc_ns * 1e-9, UTC).isoformat(timespec="milliseconds"),
            "utc_ns": utc_ns,
            "monotonic_ns": monotonic_ns,
            "period_ns": self.cell.period_ns,
            "axes": list(self.cell.axes),
            "configuration": self.cell.configuration,
            "sha256": self.cell.sha256,
            "path": self.cell.path,
        }
        rows = _between(rows, cycle - self._cycles(BEFORE_S), cycle + self._cycles(AFTER_S))
        return Box(meta, rows, self._parameters(rows), state, _events(state))

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
