"""The process image as Python sees it: the worker that fills it, and the host that looks at it."""

from __future__ import annotations

import math
import mmap
import os
import time
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from micromanip.rt import bus_image as rt
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS

from .driver import Inbox


class ProcessImage:
    """One bus' image (``rt.image.IMAGE``)."""

    def __init__(self, record: NDArray[Any]) -> None:
        """`record` is an array (1,) of IMAGE in shared memory."""
        self._record = record
        self._values = np.zeros(MAX_OUTPUTS)
        self._readings = np.zeros(MAX_SIGNALS)
        self._written_ns = 0

    @classmethod
    def attach(cls, descriptor: int, offset: int) -> Self:
        """The image at `offset` (bytes) of an inherited segment, for writing."""
        memory = mmap.mmap(descriptor, os.fstat(descriptor).st_size)
        return cls(np.frombuffer(memory, rt.IMAGE, 1, offset))

    @property
    def link(self) -> str:
        """Where the link stands: down, up, latched."""
        return rt.LINK_NAMES[self.ask(rt.LINK)]

    @property
    def output_state(self) -> str:
        """What the outputs do: at rest, following, ramping to rest; unknown without a link or a live worker."""
        silent_ns = time.monotonic_ns() - self.ask(rt.ALIVE_NS)
        reached = self.ask(rt.LINK) == rt.LINK_UP and silent_ns <= self._record[0]["silent_ns"]
        return rt.OUTPUT_NAMES[self.ask(rt.OUTPUT_STATE) if reached else rt.UNKNOWN]

    def count_as_lost_after(self, silent_ns: int) -> None:
        """Let the loop take a worker that has been silent for so long for dead."""
        self._record[0]["silent_ns"] = silent_ns

    def ask(self, word: int) -> int:
        """One of the words."""
        return int(rt.ask(self._record, word))

    def tell(self, word: int, value: int) -> None:
        """Write one of the worker's words."""
        rt.tell(self._record, word, value)

    def take_over(self) -> None:
        """Begin where another worker may have died in the middle of writing."""
        rt.take_over(self._record)

    def publish(self, inbox: Inbox) -> None:
        """Hand all samples to the loop; the inbox is empty then."""
        for first, values, time_ns, status, lost in inbox.readings:
            count = len(values)
            if count == 1:
                rt.publish(self._record, first, values[0], time_ns, status, lost)
            else:
                self._readings[:count] = values
                rt.publish_all(self._record, first, count, self._readings, time_ns, status, lost)
        inbox.clear()

    def wanted(self) -> tuple[NDArray[np.float64], int]:
        """What the loop wants of the outputs (MAX_OUTPUTS,), and when it wrote that (ns, 0 if never)."""
        written_ns = int(rt.take_outputs(self._record, self._values))
        if written_ns >= 0:
            self._written_ns = written_ns
        return self._values, self._written_ns

    def known(self, count: int) -> list[float | None] | None:
        """What each of `count` outputs was given last, None for one of which nobody knows; None if nothing ever was."""
        if not self.ask(rt.SENT_NS):
            return None
        return [value if math.isfinite(value) else None for value in self._record[0]["sent"][:count].tolist()]

    def remember_sent(self, values: NDArray[np.float64], now_ns: int) -> None:
        """Note what the device was given."""
        rt.remember_sent(self._record, values, now_ns)
