"""The learning process: watches the parts of a running cell, and keeps what is learned of them.

Started by the host as ``python -m micromanip.learner.process`` in a session of its own, below everything else in
precedence. It maps the telemetry for reading, and writes two things: the memories' files, and the rows to be played,
into a memory of its own that the host copies. Standard input brings the orders, then of which axes to forget
everything, and how warm the cell is; standard output says, a JSON object a line, what became of each part.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.bus.report import first_orders, send_message
from micromanip.design.learning.law import Update
from micromanip.errors import MicromanipError
from micromanip.host.shared_memory import RING, RingReader, Segment
from micromanip.settings.load import validate_document
from micromanip.settings.text.source import Source

from .memory_store import MemoryStore
from .part_collector import MadePart, PartCollector

_LOOK_S = 0.05
_NICE = 10


class Learner:
    """One configuration, until its tuning is changed."""

    def __init__(self, orders: dict[str, Any], reader: RingReader) -> None:
        """Raises CheckFailed where an axis can't learn."""
        configuration = validate_document(Source.parse(Path(orders["path"]), orders["configuration"]))
        assert configuration.learning is not None
        self._reader = reader
        self._store = MemoryStore(configuration, Path(orders["folder"]))
        self._collector = PartCollector(configuration.learning.seconds, configuration.loop.period_ns * 1e-9)
        self._found: deque[MadePart | str] = deque()
        self._room = np.frombuffer(Segment.attach(orders["rows"], writable=True).memory, np.float64)
        self._temperature_C: float | None = None
        self._shown_tool: int | None = None

    def read(self) -> None:
        """Take over the memories that there are."""
        for problem in self._store.read():
            send_message(warning=problem)
        send_message(ready=True)

    def obey(self, order: dict[str, Any]) -> None:
        """The host has another temperature, or axes to be forgotten: by each name whether its files are kept."""
        if "temperature_C" in order:
            self._temperature_C = order["temperature_C"]
        for name, keep in order.get("forget", {}).items():
            self._collector.drop()
            self._shown_tool = None
            try:
                send_message(forgotten=name, aside=self._store.forget(name, keep=keep))
            except MicromanipError as problem:
                send_message(warning=f"{problem}; nothing is learned or played of axis {name}")

    def follow(self) -> None:
        """Take what has come since the last time; learn from a part that is whole."""
        self._take()
        while self._found:
            found = self._found.popleft()
            if isinstance(found, str):
                send_message(unfinished=found)
            else:
                self._learn(found)
        if self._collector.tool != self._shown_tool:
            self._show(self._collector.tool)

    def _take(self) -> None:
        """Also between the axes that learn: the next part does not wait for that."""
        while len(rows := self._reader.read()):
            self._found.extend(self._collector.add(rows))

    def _learn(self, part: MadePart) -> None:
        learned, refused = {}, {}
        for name, found in self._store.learn(part, self._take, self._temperature_C):
            if isinstance(found, Update):
                learned[name] = _as_message(found)
                self._shown_tool = None
            else:
                refused[name] = str(found)
        send_message(part=part.number, learned=learned, refused=refused)

    def _show(self, tool: int) -> None:
        """Show the host what is to be played from now on with `tool`."""
        rows = self._store.rows(tool).ravel()
        self._room[:] = rows
        self._shown_tool = tool
        axes = {
            name: {"tuning": each.tuning, "generation": each.generation, "temperature_C": each.temperature_C}
            for name, each in self._store.of_tool(tool).items()
        }
        send_message(shown=hashlib.sha256(rows.tobytes()).hexdigest(), tool=tool, axes=axes)


def _as_message(found: Update) -> dict[str, Any]:
    """What the host, its status and the audit trail say of an update."""
    now = found.memory
    return {
        "generation": now.generation, "parts": now.parts, "verdict": found.verdict, "error_um": found.error_um,
        "without_um": found.without_um, "correction_um": float(np.abs(now.correction_um).max()),
        "contraction": now.contraction, "learned_Hz": [list(band) for band in now.learned_Hz],
    }  # fmt: skip


def main() -> int:
    """Learn until standard input ends; 0, or 1 where this cell can't learn."""
    with contextlib.suppress(OSError):
        os.nice(_NICE)
    lines, orders = first_orders()
    if orders is None:
        return 0
    reader = RingReader(Segment.attach(orders["ring"], writable=False).record(RING))
    try:
        learner = Learner(orders, reader)
    except MicromanipError as problem:
        send_message(hopeless=str(problem))
        return 1
    learner.obey(orders)
    learner.read()
    while not lines.ended:
        for order in lines.within(_LOOK_S):
            learner.obey(order)
        learner.follow()
    return 0


if __name__ == "__main__":
    sys.exit(main())
