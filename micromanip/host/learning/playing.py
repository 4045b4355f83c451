"""What the loop plays of what was learned: put in force while no part is being made, told where it ends early."""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from micromanip.control.learned import ASIDE
from micromanip.errors import CheckFailed
from micromanip.faults import KINDS
from micromanip.host.controller import Controller
from micromanip.replies import Change
from micromanip.rt import mailbox as w
from micromanip.rt.laws.learned import BROKEN_OFF, OTHER_TOOL, PART_ENDED, PATH_LEFT
from micromanip.rt.states import NO_FAULT, REFERENCE_LOST, TRACKING, WARN
from micromanip.settings.schema.learning import Learning

from ..state_directory import memory_folder
from .correction import Correction, Memories, is_silent

Put = Callable[[Callable[[], None]], Awaitable[None]]
Note = Callable[[Sequence[Change]], Awaitable[None]]
Say = Callable[[str], None]


class Playing:
    """What one controller plays, and what it is to play next."""

    def __init__(
        self, controller: Controller, learning: Learning, correction: Correction, put: Put, note: Note, say: Say,
        put_aside: Callable[[str], None],
    ) -> None:  # fmt: skip
        """`put_aside` is to keep what was learned of an axis before a fault out of what is learned from now on."""
        self._controller, self._learning, self._correction = controller, learning, correction
        self._put, self._note, self._say, self._put_aside = put, note, say, put_aside
        self.next: Memories | None = None
        """What was learned last, and is not played yet."""
        self.ended: dict[str, int] = {}
        self._told: dict[str, int] = {}
        """By the axis: the number of the part whose correction ended early last, and the cycle in which it began."""
        self._faulted: dict[str, int] = {}
        """By the axis: the cycle of the last fault for which its memory was put aside."""

    async def look(self) -> None:
        """Tell what ended a correction early, and put memories in force while no part is made."""
        axes = list(self._controller.prepared.configuration.axes)
        cell = self._controller.status["state"][0]
        learned = cell["axis"]["learned"][: len(axes)]
        await self._drop_faulty(axes, cell)
        await self._tell_ends(axes, learned)
        with contextlib.suppress(CheckFailed):  # somebody else changes something: the next time
            await self.put_in_force(cell, learned)

    def forget(self, names: Sequence[str]) -> None:
        """The process knows nothing of them any more: what it shows from now on is new."""
        for name in names:
            self._correction.forget(name)
        if self.next is not None:
            self.next = self.next.without(names)

    async def put_in_force(self, cell: Any, learned: Any) -> None:
        """Hand a new memory over; after another tuning was put in force, the present one again."""
        correction, in_force = self._correction, self._controller.buffers.in_force
        repeats = self._learning.repeats
        # what is of another tool than that of the part is not played to it: that may change in the middle of it
        if in_force is None or (not repeats and self._is_made(cell) and in_force["learned_tool"] == cell["tool"]):
            return
        playing = in_force["axis"]["learned"]["number"][: len(learned)]
        configuration = self._controller.prepared.configuration
        should = [correction.number if correction.may_play(configuration, name) else 0 for name in configuration.axes]
        if self.next is None:
            if list(playing) != should:
                await self._put(lambda: None)
        elif repeats:
            if correction.may_hold(playing, learned) and not self._controller.buffers.is_unconfirmed:
                await self._put(self._hold_next)
        elif playing.any() or self._controller.buffers.is_unconfirmed:
            await self._put(correction.withdraw)
        elif is_silent(learned):
            await self._put(self._hold_next)

    async def _tell_ends(self, axes: Sequence[str], learned: Any) -> None:
        number = int(self._controller.status["state"][0]["parts"])
        for kind in (PATH_LEFT, BROKEN_OFF, PART_ENDED, OTHER_TOOL):
            ended = [
                i for i, name in enumerate(axes)
                if learned["why"][i] == kind and self._told.get(name) != int(learned["part"][i])
            ]  # fmt: skip
            if not ended:
                continue
            names = ", ".join(axes[i] for i in ended)
            why = {
                PATH_LEFT: "the reference is "
                f"{max(float(learned['apart_um'][i]) for i in ended):.3g} um from the path that was learned, "
                f"{self._learning.tolerance_um:g} um may be",
                BROKEN_OFF: "the axis does not track with all its sensors and its own gains",
                PART_ENDED: "the part ended before its time",
                OTHER_TOOL: f"it was learned with tool {self._correction.memories.tool}",
            }[kind]
            for i in ended:
                self.ended[axes[i]], self._told[axes[i]] = number, int(learned["part"][i])
            text = f"part {number}: the learned correction of axis {names} has faded out: {why}"
            self._say(text)
            await self._note([Change(key=f"learning.{axes[i]}", old="plays", new=text) for i in ended])

    async def _drop_faulty(self, axes: Sequence[str], cell: Any) -> None:
        """An axis that had a fault is perhaps another one now: what was learned of it before is not played any more.

        All axes that had one in the cycle of the latched fault, which must be an axis': after a link or a driver was
        lost they are as they were. The tracker's beam is not the axis.
        """
        if cell["fault"] == NO_FAULT or cell["fault_axis"] < 0:
            return
        cycle = int(cell["fault_cycle"])
        faults = {
            axes[event["axis"]]: KINDS[int(event["code"])].code
            for event in cell["event"][: int(cell["events"])]
            if event["cycle"] == cycle
            and event["axis"] >= 0
            and event["reaction"] != WARN
            and event["code"] != REFERENCE_LOST
        }
        for name, code in faults.items():
            if self._faulted.get(name) == cycle:
                continue
            self._faulted[name] = cycle
            self._correction.dropped.add(name)
            self._put_aside(name)
            before = self._correction.memories.generations.get(name)
            if before is None:
                continue
            text = (
                f"axis {name} had the fault {code}: what was learned of it before is not played any more; it is kept "
                f"in {memory_folder(self._learning, self._controller.prepared.source.path)} as {name}*.npz{ASIDE}*"
            )
            self._say(text)
            await self._note([Change(key=f"learning.{name}", old=before, new=text)])

    def _is_made(self, cell: Any) -> bool:
        """Whether a part is being made; one that nobody ends is over once it has had its time."""
        loop_hz = self._controller.prepared.configuration.loop.rate_hz
        over = round((self._learning.seconds + self._learning.search_s) * loop_hz)
        tracks = bool(self._controller.words[w.STATE] == TRACKING)
        return tracks and bool(cell["part"] != 0 and cell["cycle"] - cell["part_begun"] < over)

    def _hold_next(self) -> None:
        assert self.next is not None
        self._correction.hold(self.next)
        self.next = None
