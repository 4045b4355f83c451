"""The host's side of learning: the process that learns, what is taken of it, and what people hear of it.

The process dies, or is killed: it is started again, and what is played goes on. Rows that it shows are taken if they
are what it said they are, finite and within the limit; then they wait for the loop (`handover.py`). Nothing of this is
in a hurry, and nothing waits for it.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed, require_axis
from micromanip.faults import KINDS
from micromanip.host.child import Child
from micromanip.host.controller import Controller
from micromanip.replies import Change
from micromanip.rt import mailbox as w
from micromanip.rt.laws.learned import BROKEN_OFF, OTHER_TOOL, PART_ENDED, PATH_LEFT
from micromanip.rt.states import NO_FAULT, REFERENCE_LOST, WARN
from micromanip.settings.schema.learning import Learning
from micromanip.status_reply import AxisLearning, LearningStatus

from ..shared_memory import Segment
from ..state_directory import memory_folder
from .handover import Handover, Memories, Put

Note = Callable[[Sequence[Change]], Awaitable[None]]

_LOOK_S = 0.02
_END_S = 5.0
_TENTH_K = 0.1
_LATE_NS = 1_000_000_000
"""So much older than it may be a temperature is still good: this process reads it, which is in no hurry."""
_STATES = ("idle", "plays", "finished", "path left", "broken off", "withdrawn", "part ended", "other tool")
"""The numbers of ``rt/laws/learned.py`` as words."""


class LearningService:
    """Learning of one controller whose configuration has it."""

    def __init__(
        self, controller: Controller, learning: Learning, put: Put, note: Note, say: Callable[[str], None]
    ) -> None:
        """`put` calls what it is given while nobody else changes anything, and puts what runs in force again.

        `note` writes into the audit trail, `say` reaches people.
        """
        self._controller, self._learning, self._put, self._note, self._say = controller, learning, put, note, say
        self._axes = list(controller.prepared.configuration.axes)
        self._folder = memory_folder(learning, controller.prepared.source.path)
        table = controller.segments.sample_table()
        self._handover = Handover(learning, table)
        self._room = Segment.create("micromanip-learned", table.nbytes)
        controller.added = self._handover.added
        descriptors = controller.segments.ring.descriptor, self._room.descriptor
        self._child = Child("micromanip.learner.process", descriptors)
        self._stopping = False
        self._state = "starting"
        self._last: dict[str, dict[str, Any]] = {}
        self._made = 0
        self._forget: dict[str, bool] = {}
        """What the process has not confirmed: by the axis, whether the files of its memories are kept."""
        self._faulted: dict[str, int] = {}
        self._ended: dict[str, tuple[int, int]] = {}
        """By the axis: the cycle of the last fault; number and beginning of the part that lost its correction last."""
        self._sent_C: float | None = None
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
        axes: dict[str, AxisLearning] = {}
        for i, name in enumerate(self._axes):
            a = cell["axis"][i]["learned"]
            axes[name] = AxisLearning(
                generation=self._handover.memories.generations.get(name),
                may_play=self._handover.may_play(configuration, name), state=_STATES[int(a["why"])],
                part=int(cell["part"]) or None, apart_um=round(float(a["apart_um"]), 3), last=self._last.get(name),
            )  # fmt: skip
        return LearningStatus(
            state=self._state, made=self._made, folder=str(self._folder), axes=axes, tool=int(cell["tool"]) or None,
            temperature_C=self._temperature_C(),
        )  # fmt: skip

    async def reset(self, axes: Sequence[str]) -> list[Change]:
        """Forget the memories of `axes`, all without any; what is played of them fades out.

        UsageError for what is no axis, CheckFailed where the files stay.
        """
        for name in axes:
            require_axis(name, self._axes)
        wanted, before = list(axes) or self._axes, self._handover.memories.generations
        self._begin_anew(wanted, keep=False)
        await self._put(lambda: None)
        if self._state == "off":
            raise CheckFailed(f"nobody learns any more: it is not played, but stays in {self._folder}: remove it there")
        return [Change(key=f"learning.{name}", old=before.get(name), new=None) for name in wanted]

    def _begin_anew(self, axes: Sequence[str], *, keep: bool) -> None:
        """Nothing that was learned of `axes` is played any more; the process hears of it until it has answered."""
        self._handover.forgotten |= set(axes)
        self._forget |= dict.fromkeys(axes, keep)
        self._child.send({"forget": dict.fromkeys(axes, keep)})

    async def _keep_alive(self) -> None:
        over = lambda: self._stopping or bool(self._controller.words[w.FINISHED]) or self._state == "off"  # noqa: E731
        if not await self._child.keep_alive(self._hear_all, over, self._say, "learning"):
            self._state = "off"
            self._say("WARNING: the learning process died again; nothing is learned any more, what is played stays")

    async def _hear_all(self) -> None:
        """One process from its start to its end."""
        source = self._controller.prepared.source
        await self._child.start(
            {
                "configuration": source.text,
                "path": str(source.path),
                "folder": str(self._folder),
                "ring": self._controller.segments.ring.descriptor,
                "rows": self._room.descriptor,
                "forget": self._forget,
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
            self._forget.pop(said["forgotten"], None)
            self._handover.forget(said["forgotten"])
            if said["aside"]:
                await self._note([Change(key=f"learning.{said['forgotten']}", old=None, new=said["aside"])])
        elif "ready" in said:
            self._state = "learning"
            self._child.send({"temperature_C": self._sent_C})  # it may have changed while the process was being started
            self._say("READY to learn from part to part")
        elif "shown" in said:
            self._take(said)
        elif "unfinished" in said:
            self._say(said["unfinished"])
            await self._note([Change(key="learning", old=None, new=said["unfinished"])])
        else:
            await self._learned(said)

    def _take(self, said: dict[str, Any]) -> None:
        """Keep the rows that were shown for the loop, where they can be played."""
        copied = self._room.bytes().copy()
        if hashlib.sha256(copied.tobytes()).hexdigest() != said["shown"]:
            return  # others were shown meanwhile: the next line is of them
        rows = copied.view(np.float64).reshape(len(self._handover.memories.rows), -1)
        # an axis that the process has not forgotten yet is not taken
        axes = {name: each for name, each in said["axes"].items() if name not in self._handover.forgotten}
        found = Memories(
            rows, {name: each["tuning"] for name, each in axes.items()},
            {name: each["generation"] for name, each in axes.items()}, int(said["tool"]),
            {name: float(warm_C) for name, each in axes.items() if (warm_C := each["temperature_C"]) is not None},
        )  # fmt: skip
        problem = found.problem(self._learning, self._axes)
        if problem is not None:
            self._say(f"WARNING: the correction that was learned is not played: {problem}")
        else:
            self._handover.next = found

    async def _learned(self, said: dict[str, Any]) -> None:
        """What became of a whole part: into the trail; people hear of what was refused, where they do not know yet."""
        self._made = number = int(said["part"])
        changes = []
        for name, told in said["learned"].items():
            self._last[name] = {"part": number, **told}
            changes.append(Change(key=f"learning.{name}", old=told["generation"] - 1, new=self._last[name]))
            if told["verdict"] == "worse":
                self._say(f"part {number}: axis {name} was worse than before, beyond doubt: it learns anew")
        for why in dict.fromkeys(said["refused"].values()):
            names = [name for name, each in said["refused"].items() if each == why]
            if any(self._ended.get(name, (0, 0))[0] != number for name in names):
                self._say(f"WARNING: {why}")
            changes += [Change(key=f"learning.{name}", old=None, new=why) for name in names]
        await self._note(changes)

    async def _follow(self) -> None:
        while True:
            await asyncio.sleep(_LOOK_S)
            await self._look()

    async def _look(self) -> None:
        """Follow temperature, faults and what ended early; then hand over what is new."""
        self._handover.temperature_C = now_C = self._temperature_C()
        sent_C = self._sent_C
        if now_C is None or sent_C is None or abs(now_C - sent_C) >= _TENTH_K:
            if now_C != sent_C:
                self._child.send({"temperature_C": now_C})
            self._sent_C = now_C
        cell = self._controller.status["state"][0]
        await self._drop_faulty(cell)
        await self._publish_ends(cell)
        await self._handover.look(self._controller, self._put)

    def _temperature_C(self) -> float | None:
        """Of the cell, by the signal `temperature`; None where no usable value is there."""
        prepared = self._controller.prepared
        place = prepared.wiring.signal("temperature")
        if place < 0:
            return None
        signal = self._controller.status["signals"][place]
        most_us = prepared.configuration.signals["temperature"].max_age_us
        age_ns, value = time.monotonic_ns() - int(signal["time_ns"]), float(signal["value"])
        is_old = most_us is not None and age_ns > 1e3 * most_us + _LATE_NS
        return None if signal["sequence"] == 0 or signal["status"] != 0 or is_old or not math.isfinite(value) else value

    async def _publish_ends(self, cell: Any) -> None:
        """Say once for all its axes, and note, why a correction ended early."""
        learned, number = cell["axis"]["learned"], int(cell["parts"])
        for kind in (PATH_LEFT, BROKEN_OFF, PART_ENDED, OTHER_TOOL):
            ended = [
                i for i, name in enumerate(self._axes)
                if learned["why"][i] == kind and self._ended.get(name, (0, 0))[1] != int(learned["part"][i])
            ]  # fmt: skip
            if not ended:
                continue
            names = [self._axes[i] for i in ended]
            why = {
                PATH_LEFT: f"the reference is {max(float(learned['apart_um'][i]) for i in ended):.3g} um from the path "
                f"that was learned, {self._learning.tolerance_um:g} um may be",
                BROKEN_OFF: "the axis does not track with all its sensors and its own gains",
                PART_ENDED: "the part ended before its time",
                OTHER_TOOL: f"it was learned with tool {self._handover.memories.tool}",
            }[kind]
            self._ended |= {self._axes[i]: (number, int(learned["part"][i])) for i in ended}
            text = f"part {number}: the learned correction of axis {', '.join(names)} has faded out: {why}"
            self._say(text)
            await self._note([Change(key=f"learning.{name}", old="plays", new=text) for name in names])

    async def _drop_faulty(self, cell: Any) -> None:
        """An axis that had a fault is perhaps another one now: what was learned of it before is not played any more.

        All axes that had one in the cycle of the latched fault, which must be an axis': after a link or a driver was
        lost they are as they were. The tracker's beam is not the axis.
        """
        if cell["fault"] == NO_FAULT or cell["fault_axis"] < 0:
            return
        cycle = int(cell["fault_cycle"])
        for event in cell["event"][: int(cell["events"])]:
            if event["cycle"] != cycle or event["axis"] < 0 or event["reaction"] == WARN:
                continue
            name, before = self._axes[event["axis"]], self._handover.memories.generations
            if event["code"] == REFERENCE_LOST or self._faulted.get(name) == cycle:
                continue
            self._faulted[name] = cycle
            self._begin_anew([name], keep=True)
            if name in before:
                text = (
                    f"axis {name} had the fault {KINDS[int(event['code'])].code}: what was learned of it before is not "
                    f"played any more; it is kept in {self._folder} as {name}*.npz.before_fault"
                )
                self._say(text)
                await self._note([Change(key=f"learning.{name}", old=before[name], new=text)])
