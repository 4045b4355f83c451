"""The host's side of learning: the process that learns, what is taken of it, and what people are told.

The process dies, or is killed: it is started again, and what is played goes on. Rows that it shows are taken if they
are what it said they are, finite, within the limit and as long as a part; then they wait for the loop (`playing.py`).
Nothing of this is in a hurry, and nothing waits for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from micromanip.bus.backoff import RestartLimit
from micromanip.control.learned import ASIDE
from micromanip.errors import CheckFailed, UsageError
from micromanip.host.child import Child
from micromanip.host.controller import Controller
from micromanip.replies import Change
from micromanip.rt import mailbox as w
from micromanip.settings.schema.learning import Learning
from micromanip.status_reply import AxisLearning, LearningStatus

from ..shared_memory import Segment
from ..state_directory import memory_folder
from .correction import Correction, Memories
from .playing import Note, Playing, Put, Say
from .thermometer import Thermometer

_LOOK_S = 0.02
_RESTARTS, _WITHIN_S, _RESTART_S = 3, 600.0, 1.0
_END_S = 5.0
_TENTH_K = 0.1

WHY = ("idle", "plays", "finished", "path left", "broken off", "withdrawn", "part ended", "other tool")
"""The numbers of ``rt/laws/learned.py`` as words."""


class LearningKeeper:
    """Learning of one controller whose configuration has it."""

    def __init__(self, controller: Controller, learning: Learning, put: Put, note: Note, say: Say) -> None:
        """`put` calls what it is given while nobody else changes anything, and puts what runs in force again.

        `note` writes into the audit trail, `say` tells people.
        """
        self._controller, self._learning, self._put, self._note, self._say = controller, learning, put, note, say
        table = controller.segments.sample_table()
        self._correction = Correction(controller.prepared, learning, table)
        self._playing = Playing(controller, learning, self._correction, put, note, say, self._put_aside)
        self._room = Segment.create("micromanip-learned", table[: self._correction.rows].nbytes)
        controller.added = self._correction.added
        self._child = Child(
            "micromanip.learner.process", (controller.segments.ring.descriptor, self._room.descriptor),
            restarts=RestartLimit(_RESTARTS, _WITHIN_S),
        )  # fmt: skip
        self._stopping = False
        self._state = "starting"
        self._parts: dict[str, dict[str, Any]] = {}
        self._made = 0
        self._forget: set[str] = set()
        self._thermometer = Thermometer(controller.prepared)
        self._told_C: float | None = None
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Start the process, without waiting for it, and follow what the loop plays."""
        self._tasks = [asyncio.create_task(self._keep_alive()), asyncio.create_task(self._follow())]

    async def end(self) -> None:
        """End the process, and let its memory go."""
        self._stopping = True
        self._child.end_orders()
        if self._tasks:
            await asyncio.wait({self._tasks[0]}, timeout=_END_S)
        self._child.kill()
        for task in self._tasks:
            task.cancel()

    def status(self) -> LearningStatus:
        """What is learned and played now."""
        configuration, cell = self._controller.prepared.configuration, self._controller.status["state"][0]
        generations = self._correction.memories.generations
        axes: dict[str, AxisLearning] = {}
        for i, name in enumerate(configuration.axes):
            a = cell["axis"][i]["learned"]
            last = self._parts.get(name, {})
            axes[name] = AxisLearning(
                generation=generations.get(name), may_play=self._correction.may_play(configuration, name),
                state=WHY[int(a["why"])], part=int(cell["part"]) or None, apart_um=round(float(a["apart_um"]), 3),
                last=last or None,
            )  # fmt: skip
        folder = memory_folder(self._learning, self._controller.prepared.source.path)
        return LearningStatus(
            state=self._state,
            made=self._made,
            folder=str(folder),
            axes=axes,
            tool=int(cell["tool"]) or None,
            temperature_C=self._warm_C(),
        )

    async def state_tool(self, tool: int) -> list[Change]:
        """From now on it is this one, 0: none is told. UsageError where the machine says it, CheckFailed on trial."""
        if tool and "tool" in self._controller.prepared.configuration.signals:
            raise UsageError("the signal tool says which tool it is: leave out --tool")
        before = self._correction.stated_tool
        if tool == before:
            return []
        try:
            await self._put(lambda: setattr(self._correction, "stated_tool", tool))
        except CheckFailed:
            self._correction.stated_tool = before
            raise
        return [Change(key="learning.tool", old=before, new=tool)]

    async def reset(self, axes: Sequence[str]) -> list[Change]:
        """Forget the memories of `axes`, all without any; what is played of any axis fades out. UsageError."""
        known = list(self._controller.prepared.configuration.axes)
        for name in axes:
            if name not in known:
                raise UsageError(f"there is no axis {name}; the axes are {', '.join(known)}")
        wanted, before = list(axes) or known, self._correction.memories.generations
        self._playing.next = None
        await self._put(self._correction.withdraw)
        self._forget |= set(wanted)  # until it has: it may have died
        self._child.tell({"forget": wanted})
        return [Change(key=f"learning.{name}", old=before.get(name), new=None) for name in wanted]

    async def _keep_alive(self) -> None:
        while True:
            await self._hear_all()
            if self._stopping or self._controller.words[w.FINISHED] or self._state == "off":
                return
            if not self._child.may_restart():
                break
            self._say("WARNING: the learning process died; it is started again, what is played stays")
            await asyncio.sleep(_RESTART_S)
            if self._stopping:
                return
        self._state = "off"
        self._say("WARNING: the learning process died again; nothing is learned any more, what is played stays")

    async def _hear_all(self) -> None:
        """One process from its start to its end."""
        source = self._controller.prepared.source
        await self._child.start(
            {
                "configuration": source.text,
                "path": str(source.path),
                "folder": str(memory_folder(self._learning, source.path)),
                "ring": self._controller.segments.ring.descriptor,
                "rows": self._room.descriptor,
                "forget": sorted(self._forget),
                "aside": sorted(self._correction.dropped),
                "temperature_C": self._told_C,
            }
        )
        async for said in self._child.answers():
            await self._hear(said)
        await self._child.wait()

    async def _hear(self, said: dict[str, Any]) -> None:
        if "warning" in said:
            self._say(f"WARNING: {said['warning']}")
        elif "hopeless" in said:
            self._state = "off"
            self._say(f"WARNING: nothing is learned: {said['hopeless']}")
        elif "forgotten" in said:
            self._forget -= set(said["forgotten"])
        elif "aside" in said:
            self._playing.forget(said["aside"])
            if said["files"]:
                await self._note(
                    [Change(key="learning", old=file.partition(ASIDE)[0], new=file) for file in said["files"]]
                )
        elif "moved" in said:
            self._say(said["moved"])
            await self._note([Change(key="learning", old=None, new=said["moved"])])
        elif "ready" in said:
            self._state = "learning"
            # whatever changed while it was being started
            self._child.tell({"temperature_C": self._told_C})
            if self._correction.dropped:
                self._child.tell({"aside": sorted(self._correction.dropped)})
            self._say("READY to learn from part to part")
        elif "staged" in said:
            self._playing.next = self._taken(said)
            self._child.tell({"taken": said["staged"]})
        elif "begun" in said:
            for name, cycle in said["begun"].items():
                self._correction.recognised(name, int(cycle))
            if said["begun"] and self._correction.number:
                with contextlib.suppress(CheckFailed):  # another change is under way: this part goes without
                    await self._put(lambda: None)
        elif "unfinished" in said:
            self._say(said["unfinished"])
            await self._note([Change(key="learning", old=None, new=said["unfinished"])])
        else:
            await self._learned(said)

    def _taken(self, said: dict[str, Any]) -> Memories | None:
        """The rows that were shown, None where they can't be played."""
        copied = self._room.bytes().copy()
        rows = copied.view(np.float64).reshape(self._correction.rows, -1)
        # shown before it had put aside what it was told to
        axes = {name: each for name, each in said["axes"].items() if name not in self._correction.dropped}
        found = Memories(
            rows, {name: each["tuning"] for name, each in axes.items()},
            {name: each["generation"] for name, each in axes.items()}, int(said.get("tool", 0)),
            {name: float(warm_C) for name, each in axes.items() if (warm_C := each.get("temperature_C")) is not None},
        )  # fmt: skip
        problem = found.problem(self._controller.prepared.configuration)
        if hashlib.sha256(copied.tobytes()).hexdigest() != said["sha256"]:
            problem = "it is not what the learning process wrote"
        if problem is not None:
            self._say(f"WARNING: the correction that was learned is not played: {problem}")
            return None
        return found

    async def _learned(self, said: dict[str, Any]) -> None:
        """What became of a whole part: into the trail; people hear of what was refused, where they do not know yet."""
        self._made = number = int(said["part"])
        changes = []
        for name, told in said["learned"].items():
            self._parts[name] = {"part": number, **told}
            changes.append(Change(key=f"learning.{name}", old=told["generation"] - 1, new={"part": number, **told}))
            if told["forgotten"]:
                self._say(
                    f"part {number}: axis {name} was worse than before, beyond doubt: back to what was played then"
                )
        for why in dict.fromkeys(said["refused"].values()):
            names = [name for name, each in said["refused"].items() if each == why]
            if any(self._playing.ended.get(name) != number for name in names):
                self._say(f"WARNING: {why}")
            changes += [Change(key=f"learning.{name}", old=None, new=f"part {number} refused: {why}") for name in names]
        await self._note(changes)

    async def _follow(self) -> None:
        while True:
            await asyncio.sleep(_LOOK_S)
            self._tell_temperature()
            await self._playing.look()

    def _put_aside(self, axis: str) -> None:
        self._child.tell({"aside": [axis]})  # those of other tools, too

    def _warm_C(self) -> float | None:
        return self._thermometer.read_C(self._controller.status["signals"], time.monotonic_ns())

    def _tell_temperature(self) -> None:
        """The process hears of each tenth of a kelvin."""
        now_C, told_C = self._warm_C(), self._told_C
        self._correction.temperature_C = now_C
        alike = now_C == told_C or (now_C is not None and told_C is not None and abs(now_C - told_C) < _TENTH_K)
        if not alike:
            self._told_C = now_C
            self._child.tell({"temperature_C": now_C})
