"""The learning process: watches the parts of a running cell, and keeps what is learned of them.

Started by the host as ``python -m micromanip.learner.process`` in a session of its own, below everything else in
precedence. It maps the telemetry for reading, and writes two things: the memories' files, and the rows to be played,
into a memory of its own that the host takes them from. Standard input brings the orders, then what to forget, which
rows were taken, how warm the cell is, and of which axes nothing counts any more after a fault; standard output tells, a
JSON object a line, what became of each part.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.control.learned import RECOGNISED_S
from micromanip.design.learning.law import Update
from micromanip.errors import MicromanipError
from micromanip.host.orders import Orders, tell
from micromanip.host.ring import RingReader
from micromanip.host.shared_memory import RING, Segment
from micromanip.settings.load import validate_document
from micromanip.settings.text.source import Source

from .gathering import Gathering, MadePart
from .memories import Memories

_LOOK_S = 0.05
_NICE = 10


class Learning:
    """One configuration, until its tuning is changed."""

    def __init__(self, orders: dict[str, Any], reader: RingReader) -> None:
        """Raises CheckFailed where an axis can't learn."""
        configuration = validate_document(Source.parse(Path(orders["path"]), orders["configuration"]))
        learning = configuration.learning
        assert learning is not None
        self._reader = reader
        self._memories = Memories(configuration, learning, Path(orders["folder"]))
        period_s = configuration.loop.period_ns * 1e-9
        self._gathering = Gathering(
            learning.seconds, self._memories.search_s, RECOGNISED_S, period_s, repeats=learning.repeats
        )
        self._repeats, self._passed_over = learning.repeats, 0
        self._room = np.frombuffer(Segment.attach(orders["rows"], writable=True).memory, np.float64)
        self._room_is_free, self._staged, self._new = True, 0, True
        self._temperature_C: float | None = orders["temperature_C"]
        self._is_first, self._staged_tool = True, 0

    def read(self) -> None:
        """Take over the memories that there are."""
        for problem in self._memories.read():
            tell(warning=problem)
        self._stage()
        tell(ready=True)

    def follow(self) -> None:
        """Take what has come since the last time; learn from a part that is whole."""
        self._take()
        self._move()
        for part in self._gathering.whole():
            self._learn(part)
        self._stage()

    def forget(self, axes: list[str]) -> None:
        """Remove memories; what is being made is not learned from."""
        self._gathering.drop()
        try:
            self._memories.forget(axes)
        except MicromanipError as problem:
            tell(warning=str(problem))
        tell(forgotten=axes)
        self._new = True

    def put_aside(self, axes: list[str]) -> None:
        """Nothing that was learned of `axes` before a fault of theirs is gone by; it stays, under another name.

        The host goes on to play nothing of an axis of which that was not told.
        """
        self._gathering.drop()
        files, problems = self._memories.put_aside(axes)
        for name, problem in problems.items():
            tell(warning=f"{problem}; nothing is learned or played of axis {name}")
        tell(aside=[name for name in axes if name not in problems], files=files)
        self._new = True

    def warm(self, temperature_C: float | None) -> None:
        """The cell has another temperature, or none that is known."""
        self._temperature_C = temperature_C

    def taken(self) -> None:
        """The host has taken the rows, or refused them."""
        self._room_is_free = True

    def _take(self) -> None:
        """Also between the axes that learn: the next part does not wait for that."""
        while len(rows := self._reader.read()):
            for unfinished in self._gathering.add(rows):
                tell(part=self._gathering.parts, unfinished=unfinished)
        for part in self._gathering.recognisable():
            if self._memories.search_s or self._repeats:
                tell(part=part.number, begun=self._memories.recognised(part))

    def _move(self) -> None:
        """Go by the memories of the present tool and temperature."""
        if not self._gathering.heard:
            return
        said = self._memories.move_to(self._memories.conditions(self._gathering.tool, self._temperature_C))
        if said is not None and not self._is_first:
            tell(moved=said)
        self._new = self._new or said is not None or self._memories.tool != self._staged_tool
        self._is_first = False

    def _learn(self, part: MadePart) -> None:
        if self._repeats and part.number == self._passed_over:
            return
        told, refused = {}, {}
        for name, found in self._memories.learn(part, self._take, self._temperature_C):
            if isinstance(found, Update):
                told[name] = _told(found)
            else:
                refused[name] = str(found)
        self._new = self._new or bool(told)
        tell(part=part.number, learned=told, refused=refused)
        if self._repeats and told:
            self._follow_periods(part, list(told))

    def _follow_periods(self, part: MadePart, axes: list[str]) -> None:
        """When the periods really begin, which nobody else says; in the next one the memory is still the old one."""
        begun = {name: self._memories.begun[name] for name in axes}
        self._gathering.move(round(float(np.median(list(begun.values())))) - part.begun)
        self._passed_over = part.number + 1
        tell(part=part.number, begun=begun)

    def _stage(self) -> None:
        """Show the host what is to be played from now on, once it has taken what was shown before."""
        if not (self._new and self._room_is_free):
            return
        self._new, self._room_is_free, self._staged = False, False, self._staged + 1
        rows = self._memories.rows() if self._memories.known else np.zeros_like(self._room)
        flat = np.zeros(len(self._room))
        flat[: min(rows.size, len(flat))] = rows.ravel()[: len(flat)]
        self._room[:] = flat
        self._staged_tool = self._memories.tool
        known = self._memories.known
        tell(
            staged=self._staged,
            sha256=hashlib.sha256(flat.tobytes()).hexdigest(),
            tool=self._staged_tool,
            axes={
                name: {"tuning": each.tuning, "generation": each.generation, "temperature_C": each.temperature_C}
                for name, each in known.items()
            },
        )


def _told(found: Update) -> dict[str, Any]:
    """What the host, its status and the audit trail say of an update."""
    now = found.memory.now
    return {
        "generation": found.memory.generation, "parts": now.parts, "verdict": found.verdict,
        "forgotten": found.forgotten, "error_um": found.error_um, "without_um": found.without_um,
        "correction_um": float(np.abs(now.correction_um).max()), "contraction": now.contraction,
        "learned_Hz": [list(band) for band in now.learned_Hz],
    }  # fmt: skip


def main() -> int:
    """Learn until standard input ends; 0, or 1 where this cell can't learn."""
    for number in (signal.SIGINT, signal.SIGTERM):  # sent to all processes of a service; the host ends this one
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.nice(_NICE)
    told = Orders(sys.stdin.fileno())
    orders = told.next()
    if orders is None:
        return 0  # the host died as it started us
    reader = RingReader(Segment.attach(orders["ring"], writable=False).record(RING))
    try:
        learning = Learning(orders, reader)
    except MicromanipError as problem:
        tell(hopeless=str(problem))
        return 1
    if orders["forget"]:
        learning.forget(orders["forget"])
    if orders["aside"]:
        learning.put_aside(orders["aside"])
    learning.read()
    while not told.ended:
        for news in told.within(_LOOK_S):
            if "forget" in news:
                learning.forget(news["forget"])
            if "aside" in news:
                learning.put_aside(news["aside"])
            if "temperature_C" in news:
                learning.warm(news["temperature_C"])
            if "taken" in news:
                learning.taken()
        learning.follow()
    return 0


if __name__ == "__main__":
    sys.exit(main())
