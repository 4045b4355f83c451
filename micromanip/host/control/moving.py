"""One move of one held axis at a time: begun, followed, and ended gently whatever happens.

The loop plays it, and ends it where the hold ends. The host lets it come to rest where whoever asked for it does not
ask any more, or says stop; the axis is then held where it came to rest. Nothing here arms, and nothing is repeated.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from typing import Any

from micromanip.control.moves import Move
from micromanip.errors import CheckFailed, MicromanipError, UsageError
from micromanip.replies import Moved
from micromanip.rt.states import HOLDING, STATE_NAMES
from micromanip.settings.move_plan import HeldAxis, MoveRequest, plan_move

from ..controller import Controller

_LOOK_S, _LEASE_S, _LATE_S = 0.02, 1.0, 2.0
"""How often it is looked at; one that nobody asks about for so long ends; so much longer it may take than planned."""


_MOST_LOOKS = 2.0
"""What one look counts for at most, in terms of the time between two."""


class Lease:
    """On what somebody has begun: they ask for it again and again, or it ends after some time without a question.

    A host that was held up itself finds the client's questions only after its own look: its delay is not the client's
    silence, so a look counts for little more than the time between two.
    """

    def __init__(self, seconds: float, look_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        """It runs out after `seconds`, looked at every `look_s`."""
        self.seconds, self._most_s, self._clock = seconds, _MOST_LOOKS * look_s, clock
        self._unasked_s, self._looked_s = 0.0, clock()

    def renew(self) -> None:
        """Somebody has asked."""
        self._unasked_s, self._looked_s = 0.0, self._clock()

    def ran_out(self) -> bool:
        """Whether nobody has asked for so long; asked at each look."""
        now_s = self._clock()
        self._unasked_s += min(now_s - self._looked_s, self._most_s)
        self._looked_s = now_s
        return self._unasked_s > self.seconds


class Moving:
    """The move that is under way, or the last one."""

    def __init__(self, controller: Controller) -> None:
        """None yet."""
        self._controller = controller
        self._number, self._lease, self._stopped = 0, Lease(_LEASE_S, _LOOK_S), ""
        self._index = 0
        self._move: Move | None = None
        self._task: asyncio.Task[Moved] | None = None
        self._what = ""

    @property
    def runs(self) -> bool:
        """Whether one is under way."""
        return self._task is not None and not self._task.done()

    def require_none(self, refused: str = "nothing was changed") -> None:
        """Raise CheckFailed while one is under way."""
        if self.runs:
            raise CheckFailed(f"{refused}: {self._what} is under way; wait for its end, or `micromanip hold` ends it")

    async def begin(self, axis: str, wanted: MoveRequest) -> Moved:
        """Let the loop move `axis`; UsageError or CheckFailed says why not. Nobody else changes anything meanwhile."""
        self.require_none("move refused")
        controller = self._controller
        configuration, parameters = controller.prepared.configuration, controller.prepared.parameters
        self._require_held()
        index = list(configuration.axes).index(axis) if axis in configuration.axes else 0
        held = HeldAxis(parameters[0]["axis"][index], controller.status["state"][0]["axis"][index].copy())
        move = await asyncio.to_thread(plan_move, configuration, axis, wanted, held)
        self._number, self._index, self._move = self._number + 1, index, move
        self._stopped, self._what = "", f"a {wanted.kind} of axis {axis}"
        async with controller.commanding():
            self._require_held()
            await self._put(stop=False)
        self._lease = Lease(_LEASE_S, _LOOK_S)
        self._task = asyncio.create_task(self._follow(move))
        return self._report(done=False)

    def look(self, number: int, *, stop: bool = False) -> Moved:
        """Where move `number` stands, which is to come to rest where `stop`; CheckFailed where it was ended early."""
        if number != self._number or self._task is None:
            raise UsageError(f"move: there is no move {number}, the last is {self._number}")
        self._lease.renew()
        if stop:
            self.stop("as was asked for")
        return self._task.result() if self._task.done() else self._report(done=False)

    def stop(self, why: str) -> None:
        """Let it come to rest, where one is under way."""
        if self.runs and not self._stopped:
            self._stopped = why

    @property
    def _state(self) -> Any:
        return self._controller.status["state"][0]["axis"][self._index]["move"]

    def _require_held(self) -> None:
        if (state := self._controller.state) != STATE_NAMES[HOLDING]:
            raise CheckFailed(f"move refused: the state is {state}; an axis is moved while HOLDING (`micromanip hold`)")
        if faults := self._controller.faults():
            raise CheckFailed(f"move refused: it is held because of a fault: {faults[-1].seen}")

    def _report(self, *, done: bool) -> Moved:
        assert self._move is not None
        begun, state = int(self._state["begun_cycle"]), self._state
        ours = int(state["number"]) == self._number
        passed = float(state["passed"]) if ours else 0.0
        return Moved(
            number=self._number,
            done=done,
            progress=round(min(1.0, passed / self._move.cycles), 3),
            seconds=self._move.cycles * self._controller.prepared.configuration.loop.period_ns * 1e-9,
            begun_cycle=begun if ours else None,
            offset_um=round(float(state["offset_um"]), 4) if ours else 0.0,
        )

    async def _put(self, *, stop: bool) -> None:
        assert self._move is not None
        parameters = self._controller.prepared.parameters.copy()
        self._move.fill(parameters[0]["axis"][self._index]["move"], self._number, stop=stop)
        await self._controller.inject(parameters)

    async def _follow(self, move: Move) -> Moved:
        period_s = self._controller.prepared.configuration.loop.period_ns * 1e-9
        end_s = time.monotonic() + move.cycles * period_s + _LATE_S
        told = ""
        try:
            while not self._is_over():
                await asyncio.sleep(_LOOK_S)
                now_s = time.monotonic()
                if self._lease.ran_out():
                    self.stop(f"nobody has asked for it for {self._lease.seconds:g} s")
                if now_s > end_s:
                    self.stop("it took too long: the loop misses cycles")
                if self._stopped and not told:
                    told, end_s = self._stopped, now_s + move.stop_cycles * period_s + _LATE_S
                    await self._put(stop=True)
                elif told and now_s > end_s:
                    break
            report = self._report(done=True)
            if state := self._left():
                raise CheckFailed(f"the move was ended by the loop: {state}")
            if self._stopped:
                raise CheckFailed(
                    f"the move was stopped: {self._stopped}; the axis is held {report['offset_um']:g} um from where it "
                    "began"
                )
            return report
        finally:
            with contextlib.suppress(MicromanipError):
                await self._controller.inject(self._controller.prepared.parameters)

    def _is_over(self) -> bool:
        return bool(self._left()) or (int(self._state["number"]) == self._number and self._state["over"] != 0)

    def _left(self) -> str:
        """Why the axis is not held as it was, or nothing."""
        if (state := self._controller.state) != STATE_NAMES[HOLDING]:
            return f"the state is {state}"
        if faults := self._controller.faults():
            return faults[-1].seen
        ends = int(self._state["number"]) == self._number and self._state["over"] != 0
        early = ends and self._move is not None and self._state["passed"] < self._move.cycles and not self._stopped
        return "a sensor of the axis is not usable" if early else ""
