"""Our SYNCs, and when the values of a PDO were taken: records, and one law for Python and compiled code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from micromanip.driver import Compiler
from micromanip.driver.wire import move, record

from ..canbus.records import FRAMES, MAX_MESSAGES

compiled = Compiler(__file__, also=(Path(__file__).parents[1] / "canbus",))

REMEMBERED = 16
"""So many of our last SYNCs are."""

SYNCS = record(("count", "i8"), ("kept", "i8"), ("sent_ns", "i8", (REMEMBERED,)))
"""Our SYNCs: how many there were, how many of the last are known, and when those went out."""

SAMPLING = record(
    ("every", "i8"),
    ("frame_ns", "i8"),
    ("latency_ns", "i8"),
    ("lasting_ns", "i8"),
    ("waiting_ns", "i8"),
    ("least_ns", "i8"),
    ("answered", "i8"),
    ("came", "i8"),
    ("last", "u8"),
)
"""A PDO that comes: each `every` n-th SYNC is answered within `lasting_ns`, 0 for one that comes by itself; it waits
for the bus for `waiting_ns` at worst. The SYNC that was answered last (0: none since the opening), the least time that
an answer took since then, the PDO that came last."""

CONTEXT = record(
    *FRAMES,
    ("sampling", SAMPLING, (MAX_MESSAGES,)),
    ("syncs", SYNCS),
    ("sync_task", "i8"),
    ("sync_frame_ns", "i8"),
    ("overdue_ns", "i8"),
    ("pdos", "i8"),
    ("lost", "i8"),
    ("repeated", "i8"),
)
"""The driver as compiled code sees it: one `sampling` for each message that is received, the task that is the SYNC (-1:
none) and how long that is on the bus; from `overdue_ns` on a heartbeat is missing, which Python judges."""


REPEATED = -1
"""What ``sampled`` says instead of what is missing where a PDO is no fresh sample."""


@compiled
def note_sync(s: Any, time_ns: int) -> None:
    """One was on the bus at `time_ns`."""
    s["count"] += 1
    s["kept"] = min(s["kept"] + 1, REMEMBERED)
    s["sent_ns"][s["count"] % REMEMBERED] = time_ns


@compiled
def first_sync(s: Any, after: int, from_ns: int, to_ns: int) -> int:
    """Number of the first above `after` that was sent in that time; 0 without one."""
    number: int = max(after, s["count"] - s["kept"]) + 1
    while number <= s["count"]:
        if from_ns <= s["sent_ns"][number % REMEMBERED] <= to_ns:
            return number
        number += 1
    return 0


@compiled
def last_sync(s: Any, after: int, from_ns: int, to_ns: int) -> int:
    """Number of the last above `after` that was sent in that time; 0 without one."""
    number: int = s["count"]
    while number > max(after, s["count"] - s["kept"]):
        if from_ns <= s["sent_ns"][number % REMEMBERED] <= to_ns:
            return number
        number -= 1
    return 0


@compiled
def sampled(s: Any, p: Any, received_ns: int, data: Any) -> tuple[int, int]:
    """When the values of a PDO were taken, and how many samples before them are missing, or REPEATED.

    `data` are its bytes as one number (uint64). One that the node sends by its own clock was taken just before.

    A synchronous one was taken at the SYNC that it answers, however long it then waited for the bus. SYNCs are answered
    in their order, which matters when one was sent late and the next one is close behind: it is the answer to the first
    that it can be, had it waited for all that may go before it. Longer ago it was a SYNC only where there is no later
    one. One that no PDO answered within its time is a lost sample. The same PDO twice for one SYNC is a repetition, and
    no fresh sample; another one for the same SYNC is not the answer to it, and dated by its reception.
    """
    began_ns = received_ns - p["frame_ns"]
    repeated = p["came"] != 0 and data == p["last"]
    p["came"], p["last"] = 1, data
    if p["every"] == 0:
        return began_ns - p["latency_ns"], 0
    answered, earliest_ns = p["answered"], began_ns - p["lasting_ns"]
    number = first_sync(s, answered, max(earliest_ns, began_ns - p["least_ns"] - p["waiting_ns"]), began_ns)
    if number == 0:
        number = last_sync(s, answered, earliest_ns, began_ns)
    if number == 0:
        recent = first_sync(s, answered - 1, earliest_ns, began_ns) != 0
        return began_ns - p["latency_ns"], REPEATED if repeated and recent else 0
    missing = 0
    if answered != 0:
        missing = max(0, int(np.rint((number - answered) / p["every"])) - 1)
    p["answered"] = number
    p["least_ns"] = min(p["least_ns"], began_ns - s["sent_ns"][number % REMEMBERED])
    return s["sent_ns"][number % REMEMBERED] - p["latency_ns"], missing


class SyncTimes:
    """When our last SYNCs went out, in a record that compiled code may go on with."""

    def __init__(self) -> None:
        self.record = np.zeros(1, SYNCS)[0]

    def move_to(self, record: Any) -> None:
        """Keep them in this record from now on."""
        self.record = move(self.record, record)

    def clear(self) -> None:
        """Forget them: the bus was opened anew."""
        self.record["kept"] = 0

    def add(self, time_ns: int) -> None:
        """One was on the bus at `time_ns`."""
        note_sync(self.record, time_ns)


class Sampling:
    """Of one PDO, in a record that compiled code may go on with."""

    def __init__(
        self, syncs: SyncTimes, every: int, frame_ns: int, latency_ns: int, lasting_ns: int, waiting_ns: int
    ) -> None:
        """Each `every` n-th SYNC is answered within `lasting_ns` by a frame of `frame_ns`, 0 for one that comes by
        itself, which waits for the bus for `waiting_ns` at worst; values are `latency_ns` old.
        """
        self._syncs = syncs
        self.record = np.zeros(1, SAMPLING)[0]
        self.record["every"], self.record["frame_ns"] = every, frame_ns
        self.record["latency_ns"], self.record["lasting_ns"] = latency_ns, lasting_ns
        self.record["waiting_ns"], self.record["least_ns"] = waiting_ns, lasting_ns

    def move_to(self, record: Any) -> None:
        """Keep it in this record from now on."""
        self.record = move(self.record, record)

    def clear(self) -> None:
        """The bus was opened anew."""
        self.record["answered"], self.record["least_ns"] = 0, self.record["lasting_ns"]

    def taken(self, received_ns: int, data: bytes) -> tuple[int, int] | None:
        """When its values were taken, and how many samples before them are missing; None for a repetition."""
        number = np.uint64(int.from_bytes(data, "little"))
        taken_ns, missing = sampled(self._syncs.record, self.record, received_ns, number)
        return None if missing == REPEATED else (int(taken_ns), int(missing))
