"""The process image as Python sees it: the worker that fills it, and the host that looks at it."""

from __future__ import annotations

import math
import mmap
import os
import time
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from micromanip.rt import bus_image as rt
from micromanip.rt import mailbox as shared
from micromanip.rt.records import MAX_OUTPUTS

from .inbox import Inbox


class ProcessImage:
    """One bus' image (``rt.bus_image.IMAGE``)."""

    def __init__(self, record: NDArray[Any]) -> None:
        """`record` is an array (1,) of IMAGE in shared memory."""
        self.record = record
        image = record[0]
        # plain views, made once: a field of a record costs ten times an element of an array
        self._words, self._turns = memoryview(image["words"]), memoryview(image["input_turn"])
        inputs = image["input"]
        self._value: Any = memoryview(inputs["value"])
        self._time_ns = memoryview(inputs["time_ns"])
        self._sequence, self._status = memoryview(inputs["sequence"]), memoryview(inputs["status"])
        self._missing, self._turned_ns = memoryview(image["missing"]), memoryview(image["turned_ns"])
        self._count = int(image["outputs"])
        self._wanted, self._sent = image["value"][: self._count], image["sent"][: self._count]
        self._values = np.zeros(MAX_OUTPUTS)
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
        reached = self.ask(rt.LINK) == rt.LINK_UP and silent_ns <= self.record[0]["silent_ns"]
        return rt.OUTPUT_NAMES[self.ask(rt.OUTPUT_STATE) if reached else rt.UNKNOWN]

    def count_as_lost_after(self, silent_ns: int) -> None:
        """Let the loop take a worker that has been silent for so long for dead."""
        self.record[0]["silent_ns"] = silent_ns

    def ask(self, word: int) -> int:
        """One of the words."""
        return shared.ask(self._words, word)

    def tell(self, word: int, value: int) -> None:
        """Write one of the worker's words, after all that was published before."""
        shared.tell(self._words, word, value)

    def take_over(self) -> None:
        """Begin where another worker may have died in the middle of writing: what that one was writing is dropped.

        A sample that was half written keeps its sequence, so that the loop does not take it for a fresh one; it is
        marked as bad.
        """
        for i in range(int(self.record[0]["inputs"])):
            if self._turns[i] & 1:
                self._status[i] = rt.DOWN
                shared.tell(self._turns, i, self._turns[i] + 1)
        if self._words[rt.SENT_TURN] & 1:
            shared.tell(self._words, rt.SENT_TURN, self._words[rt.SENT_TURN] + 1)

    def publish(self, inbox: Inbox) -> None:
        """Hand all samples to the loop; the inbox is empty then."""
        for first, values, time_ns, status, lost in inbox.readings:
            for i, value in enumerate(values, first):
                self.publish_sample(i, value, time_ns, status, lost)
        inbox.clear()

    def publish_sample(self, channel: int, value: float, time_ns: int, status: int = 0, lost: int = 0) -> None:
        """Hand a fresh sample of one input to the loop; `lost` are missing before it."""
        turn = self._turns[channel] | 1
        shared.tell(self._turns, channel, turn)
        shared.fence()
        self._value[channel], self._time_ns[channel], self._status[channel] = value, time_ns, status
        self._sequence[channel] += 1 + lost
        self._missing[channel] += lost
        shared.tell(self._turns, channel, turn + 1)

    def wanted(self) -> tuple[NDArray[np.float64], int]:
        """What the loop wants of the outputs (MAX_OUTPUTS,), and when it wrote that (ns, 0 if never).

        As before where the loop is just writing.
        """
        for _ in range(rt.TRIES):
            turn = self.ask(rt.OUTPUT_TURN)
            if turn & 1:
                continue
            values, written_ns = self._wanted.copy(), self._words[rt.WRITTEN_NS]
            shared.fence()
            if self._words[rt.OUTPUT_TURN] == turn:
                self._values[: self._count], self._written_ns = values, written_ns
                break
        return self._values, self._written_ns

    def known(self, count: int) -> list[float | None] | None:
        """What each of `count` outputs was given last, None for one of which nobody knows; None if nothing ever was."""
        if not self.ask(rt.SENT_NS):
            return None
        return [value if math.isfinite(value) else None for value in self.record[0]["sent"][:count].tolist()]

    def tell_turn(self, indices: Sequence[int], now_ns: int) -> None:
        """Tell the loop that these outputs have had their turn."""
        for i in indices:
            shared.tell(self._turned_ns, i, now_ns)

    def remember_sent(self, values: Sequence[float], now_ns: int) -> None:
        """Note what the device was given (NaN: nobody knows), where a worker that takes this one's place begins."""
        turn = self._words[rt.SENT_TURN] | 1
        self.tell(rt.SENT_TURN, turn)
        shared.fence()
        self._sent[: len(values)] = values
        self._words[rt.SENT_NS] = now_ns
        self.tell(rt.SENT_TURN, turn + 1)
