"""The host's side of the black box: starts the process, hears what became of each trip, tells people."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from micromanip.errors import CheckFailed
from micromanip.faults import KINDS, FaultReport
from micromanip.host.child import Child
from micromanip.host.controller import Controller
from micromanip.rt import mailbox as w
from micromanip.rt.states import NO_FAULT
from micromanip.settings.text.source import Source
from micromanip.status_reply import Trip

from .process import LOOP_DEATH

_STUCK_S = {"hardware": 0.5, "simulation": 3.0}
_TELL_WITHIN_S = 1.0
_SETTLE_S = 2.0
_GIVE_UP_S = 30.0
_END_S = 20.0


class BlackBox:
    """One black-box process, started anew where it dies; the controller never waits for it but in `settle`."""

    def __init__(
        self, controller: Controller, folder: Path, kept: int, say: Callable[[str | FaultReport], None]
    ) -> None:
        """`say` gets messages, and each latched fault once."""
        self._controller, self._folder, self._kept, self._say = controller, folder, kept, say
        self._source = controller.prepared.source
        self._child = Child("micromanip.host.trips.process", controller.segments.descriptors)
        self._following: asyncio.Task[None] | None = None
        self._ready = self._stopping = self._gone = False
        self._settled: dict[int, dict[str, Any]] = {}
        self._told: int | None = None
        self._noticed: tuple[int, float] | None = None

    def start(self) -> None:
        """Start it, without waiting: a trip that comes before it is ready is still in the ring."""
        self._following = asyncio.create_task(self._keep_alive())

    async def loop_died(self, report: FaultReport) -> FaultReport:
        """Let it write the box of a loop that did not end by itself, and end; the report with that box."""
        await self.stop(report)
        return self._with_box(report, LOOP_DEATH)

    async def stop(self, died: FaultReport | None = None) -> None:
        """Let it finish and end; `died` is what happened to a loop that did not end by itself."""
        if self._following is None or self._stopping:
            return
        self._stopping = True
        if not self._child.starts or (not self._ready and died is None and self._latched() is None):
            self._child.kill()  # it had nothing to do
        else:
            if died is not None:
                self._child.send({"died": died.kind.name, "what": died.what, "value": died.value})
            self._child.end_orders()
        done, _ = await asyncio.wait({self._following}, timeout=_END_S)
        if not done:
            self._say(f"WARNING: the black box did not end within {_END_S:g} s; {self._folder} may lack the last trip")
            self._child.kill()
            await self._following

    def configured(self, source: Source) -> None:
        """From now on the controller runs another configuration."""
        self._source = source
        self._child.send(self._cell())

    async def settle(self) -> None:
        """Return once the box of the latched fault is on disk, or its failure told; CheckFailed where it is not yet."""
        end = time.monotonic() + _SETTLE_S
        while not self._gone and (key := self._latched()) is not None and key not in self._settled:
            if time.monotonic() > end:
                raise CheckFailed("reset refused: the black box of this trip is not on disk yet; try again in a moment")
            await asyncio.sleep(0.01)

    def announce(self, *, last: bool = False) -> None:
        """Tell the latched fault in full, once: as soon as its box is on disk, or without it after a second.

        Where it ended the run while another was latched that nobody has heard of yet, that one first; the `last` time
        there is nothing to wait for.
        """
        key, faults = self._latched(), self._controller.latched()
        if key is None or not faults:
            self._told = self._noticed = None
            return
        if self._noticed is None or self._noticed[0] != key:
            self._noticed = (key, time.monotonic())
        waited_s = time.monotonic() - self._noticed[1]
        if waited_s > _GIVE_UP_S and key not in self._settled:
            self._give_up(key)
        waits = not (last or key in self._settled or waited_s > _TELL_WITHIN_S or self._gone)
        if key == self._told or waits:
            return
        if len(faults) > 1 and self._told != key - 1:
            self._say(self._with_box(faults[0], key - 1))
        self._told = key
        self._say(self._with_box(faults[-1], key))

    def _give_up(self, key: int) -> None:
        """A disk that hangs must not keep the cell in FAULT for ever."""
        code = KINDS[int(self._controller.words[w.FAULT_CODE])].code
        problem = f"nothing was heard of it for {_GIVE_UP_S:g} s"
        self._hear({"key": key, "code": code, "file": str(self._folder), "problem": problem})

    def _with_box(self, report: FaultReport, key: int) -> FaultReport:
        """The report with the file of its box, where that is on disk."""
        box = self._settled.get(key)
        return replace(report, box=box["file"]) if box and "problem" not in box else report

    def report(self) -> list[Trip]:
        """All trips so far; `problem` is None where the box is on disk."""
        return [
            {
                "code": box["code"],
                "file": box["file"],
                "complete": box.get("complete", False),
                "problem": box.get("problem"),
            }
            for box in self._settled.values()
        ]

    def _latched(self) -> int | None:
        """The number of the trip that is latched; None without one."""
        if self._controller.words[w.FAULT_CODE] == NO_FAULT:
            return None
        return int(self._controller.words[w.TRIPS])

    def _cell(self) -> dict[str, Any]:
        configuration = self._controller.prepared.configuration
        return {
            "configuration": self._source.text,
            "sha256": self._source.hash,
            "path": str(self._source.path),
            "axes": list(configuration.axes),
            "drivers": list(configuration.drivers),
            "period_ns": configuration.loop.period_ns,
        }

    async def _keep_alive(self) -> None:
        over = lambda: self._stopping or bool(self._controller.words[w.FINISHED])  # noqa: E731
        if not await self._child.keep_alive(self._follow, over, self._say, "black box"):
            self._say("WARNING: the black box process died again; trips leave no black box any more")
            self._gone = True

    async def _follow(self) -> None:
        """One process from its start to its end."""
        orders = self._cell() | {
            "descriptors": self._controller.segments.descriptors,
            "folder": str(self._folder.absolute()),
            "kept": self._kept,
            "known": self._known(),
            "begun": self._begun(),
            "stuck_s": _STUCK_S[self._controller.prepared.configuration.loop.limits],
        }
        await self._child.start(orders)
        async for message in self._child.answers():
            self._hear(message)
        await self._child.wait()
        self._ready = False

    def _known(self) -> int:
        """The newest trip that a new process need not look at; one that is latched and was kept in memory was lost."""
        latched = self._latched()
        return max((key for key, box in self._settled.items() if key != latched or "problem" not in box), default=0)

    def _begun(self) -> dict[str, Any] | None:
        """The newest trip, where only its first half is on disk: ``{key, file}``."""
        newest = max(self._settled, default=0)
        box = self._settled.get(newest, {"complete": True})
        return None if "problem" in box or box["complete"] else {"key": newest, "file": box["file"]}

    def _hear(self, message: dict[str, Any]) -> None:
        if "ready" in message:
            self._ready = True
            return
        key = message["key"]
        if "lost" in message:
            self._say(f"WARNING: the black box of {message['code']} is lost: {message['lost']}")
            return
        if "problem" in message:
            self._say(
                f"WARNING: the black box of {message['code']} can't be written to {message['file']}: "
                f"{message['problem']}. It is kept in memory and tried again: make room, or start with another --trips"
            )
        elif "problem" in self._settled.get(key, {}):
            self._say(f"Black box: {message['file']}")
        self._settled[key] = message
