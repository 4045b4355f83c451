"""The compiled loop that stands in for a worker's turns (``rt/steady``): given what it needs, asked what it did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from micromanip.rt.bus_image import FOLLOWING
from micromanip.rt.jit import PLAIN, prepare
from micromanip.rt.records import MAX_OUTPUTS
from micromanip.rt.steady.records import INBOX, MAX_TASKS, SENT_IN_DOUBT, STEADY

from .driver import BusDriver, Steady
from .image import ProcessImage
from .last_given import LastGiven
from .output_writer import OutputWriter
from .safe_state import SafeState
from .schedule import Schedule

_NEVER_NS = 1 << 62
_NO_WORDS, _NO_VALUES = np.zeros(0, np.int64), np.zeros(0, np.float64)


@dataclass(frozen=True)
class Served:
    """What one stay in the compiled loop came to."""

    calls: int
    """Times that something was done, or came."""
    performed: int
    received: int
    lost: int
    decided_ns: int
    gave: bool
    """Whether outputs were given."""


class SteadyService:
    """The compiled loop of one worker."""

    def __init__(self, driver: BusDriver, steady: Steady, image: ProcessImage) -> None:
        """Loads it, or compiles it where that was not done before."""
        from micromanip.rt.steady import serving  # compiled: loaded only where it is going to be called

        self._serve: Callable[..., int] = serving.serve
        self._image, self._tasks, self._fileno = image, driver.tasks, steady.fileno
        self._steady, self._inbox = np.zeros(1, STEADY), np.zeros(1, INBOX)
        self._context = steady.context  # what it points to must stay where it is
        st = self._steady[0]
        st["receive"], st["send"], st["context"] = steady.receive, steady.send, steady.context.ctypes.data
        st["begins_ns"] = _NEVER_NS if driver.silence is None else min(driver.silence.begins_ns, _NEVER_NS)
        st["tasks"], st["outputs"] = len(driver.tasks), len(driver.outputs)
        for number, task in enumerate(driver.tasks):
            row = st["task"][number]
            row["outputs"], row["output"][: len(task.outputs)] = len(task.outputs), task.outputs
        prepare(serving.serve)

    @classmethod
    def of(cls, driver: BusDriver, image: ProcessImage) -> SteadyService | None:
        """For a driver that has the two functions, and no more tasks than there is room for; None for others."""
        if PLAIN or len(driver.tasks) > MAX_TASKS or len(driver.outputs) > MAX_OUTPUTS:
            return None
        steady = driver.steady()
        return None if steady is None else cls(driver, steady, image)

    def ask_back(self) -> None:
        """Let the compiled loop return; may be called from another thread."""
        self._steady[0]["leave"][0] = 1

    def begin(self) -> None:
        """Forget that it was asked back; what was asked of Python before this must be looked at after it."""
        self._steady[0]["leave"][0] = 0

    def serve(
        self,
        safe: SafeState,
        writer: OutputWriter,
        schedule: Schedule,
        memory: LastGiven | None,
        look_ns: int,
        until_ns: int,
    ) -> Served:
        """Serve until Python is needed, and until `until_ns` at the latest.

        The link must be open, and the outputs not on a ramp. `safe` is told what was given, and what is in doubt,
        `writer` what is not confirmed.
        """
        st, inbox = self._steady[0], self._inbox[0]
        st["descriptor"], st["look_ns"], st["until_ns"] = self._fileno(), look_ns, until_ns
        st["following"] = safe.state == FOLLOWING
        st["decided_ns"] = st["refused"] = st["skipped"] = st["calls"] = 0
        inbox["signal"]["sequence"] = self._image.record[0]["input"]["sequence"]
        inbox["missing"] = self._image.record[0]["missing"]
        inbox["received"] = inbox["lost"] = 0
        inbox["confirmed"] = 0
        st["task"]["given"] = 0
        safe.lend(st)
        writer.lend(st["task"])
        schedule.lend(st["task"])
        slot, values = (_NO_WORDS, _NO_VALUES) if memory is None else memory.lend(st)
        code = self._serve(self._steady, self._image.record, self._inbox, slot, values)
        if memory is not None:
            memory.turn = int(st["memory_turn"])
        schedule.take_back(st["task"], int(st["skipped"]))
        writer.take_back(st["task"])
        return self._taken_back(safe, code)

    def _taken_back(self, safe: SafeState, code: int) -> Served:
        st, inbox = self._steady[0], self._inbox[0]
        tasks = st["task"][: st["tasks"]]
        given = [i for task, row in zip(self._tasks, tasks, strict=True) if row["given"] for i in task.outputs]
        safe.refused += int(st["refused"])
        safe.take_back(st, given)
        if code == SENT_IN_DOUBT:
            safe.attempted(self._tasks[st["failed"]].outputs, st["value"][: st["outputs"]].tolist())
        return Served(
            int(st["calls"]),
            int(tasks["performed"].sum()),
            int(inbox["received"]),
            int(inbox["lost"]),
            int(st["decided_ns"]),
            bool(given),
        )
