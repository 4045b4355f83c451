"""What a client can ask of a running controller, and what is noted of it in the audit trail."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from micromanip import replies, status_reply
from micromanip.errors import CheckFailed, MicromanipError
from micromanip.faults import FaultReport
from micromanip.host.recording.recording import Extent
from micromanip.host.recording.recordings import Recordings
from micromanip.replies import Change
from micromanip.rt import states
from micromanip.settings.move_plan import MoveRequest
from micromanip.settings.schema.base import Settings
from micromanip.settings.text.source import Source

from ..controller import Controller
from ..learning.service import LearningService
from . import fields
from .audit import AuditTrail
from .authority import Peer, Right
from .candidate import Outcome
from .handover import telemetry
from .request import Act, Request, Verb, observing, operating
from .transaction import Tuning

Operation = Callable[[Request], Awaitable[tuple[Any, Sequence[Change]]]]
"""Does what a request asks for; its result, and what it has changed."""

_Fields = TypeVar("_Fields", bound=Settings)
_Result = TypeVar("_Result")
_LOOP = Peer("loop")
_LOOK_S = 0.2


def noted(trail: AuditTrail, operation: Operation) -> Act:
    """The result of `operation`; the trail gets what it changed, or what was asked for and why it was not done."""

    async def act(request: Request) -> Any:
        try:
            result, changes = await operation(request)
        except MicromanipError as refusal:
            await trail.note(request.peer, request.verb, _asked(request.fields), str(refusal))
            raise
        except Exception as bug:
            await trail.note(request.peer, request.verb, _asked(request.fields), f"bug: {type(bug).__name__}: {bug}")
            raise
        await trail.note(request.peer, request.verb, changes)
        return result

    return act


def _given(
    kind: type[_Fields], act: Callable[[_Fields], Awaitable[_Result]]
) -> Callable[[Request], Awaitable[_Result]]:
    """`act` on what a request gives, of this `kind`; UsageError where it is not."""

    async def read(request: Request) -> _Result:
        return await act(request.read(kind))

    return read


def _looking(kind: type[_Fields], look: Callable[[_Fields], Any]) -> Act:
    """The same of what has its answer at once."""

    async def read(request: Request) -> Any:
        return look(request.read(kind))

    return read


def _changing(kind: type[_Fields], change: Callable[[_Fields], Awaitable[Any]]) -> Operation:
    """The same of what tells itself what it has `changed`."""

    async def operation(request: Request) -> tuple[Any, Sequence[Change]]:
        done = await change(request.read(kind))
        return done, done["changed"]

    return operation


def _asked(given: Mapping[str, Any]) -> list[Change]:
    """What a request wanted: the new values of a `set` or `candidate_set`, the fields of any other."""
    changes = given.get("changes")
    wanted = changes if isinstance(changes, Mapping) else given
    return [Change(key=key, old=None, new=value) for key, value in wanted.items()]


class Verbs:
    """The verbs of one controller."""

    def __init__(
        self,
        controller: Controller,
        trail: AuditTrail,
        status: Callable[[], status_reply.Status],
        before_reset: Callable[[], Awaitable[None]],
        tell: Callable[[Source], None],
        say: Callable[[str | FaultReport], None],
        recordings: Recordings,
        operated: Callable[[Request], None],
    ) -> None:
        """`before_reset` returns when what is known of a fault is kept, or raises CheckFailed: not yet.

        `tell` hears of each configuration that has come into force; `say` gets messages for people;
        `operated` hears of each request to operate the cell, before anything is done about it.
        """
        self._before_reset, self._say, self._recordings = before_reset, say, recordings
        self._controller, self._trail, self._status, self._operated = controller, trail, status, operated
        self._outcomes: deque[Outcome] = deque()
        self._tuning = Tuning(controller, tell, self._happened)
        self.put_again = self._tuning.put_again
        self.learning: LearningService | None = None
        """Where the configuration has it."""

    def table(self) -> dict[str, Verb]:
        """Every verb by its name."""
        tuning = self._tuning
        operations: dict[str, Operation] = {
            "set": _changing(fields.Set, lambda given: tuning.set(given.changes)),
            "save": _changing(fields.Save, lambda given: tuning.save(force=given.force)),
            "reload": _changing(fields.Nothing, lambda _: tuning.reload()),
            "jog": self._jog,
            "candidate_set": _changing(fields.Set, lambda given: tuning.candidate_set(given.changes)),
            "candidate_promote": _given(fields.Nothing, lambda _: tuning.candidate_promote()),
            "candidate_discard": _given(fields.Nothing, lambda _: tuning.candidate_discard()),
            "recording_start": self._recording_start,
            "recording_stop": self._recording_stop,
            "recording_mark": self._recording_mark,
            "arm": self._commanded(states.ARM),
            "disarm": self._commanded(states.DISARM),
            "hold": self._commanded(states.HOLD),
            "reset": self._commanded(states.RESET),
            "learn_part_begin": self._commanded(states.BEGIN_PART),
            "learn_part_end": self._commanded(states.END_PART),
            "learn_reset": _given(fields.Forget, self._learn_reset),
        }
        stops = ("disarm", "hold")
        verbs = {
            "status": observing(_looking(fields.Nothing, lambda _: self._answer_status())),
            "telemetry": observing(_looking(fields.Nothing, lambda _: telemetry(self._controller))),
            "configuration": observing(_looking(fields.Nothing, lambda _: self._configuration())),
            "get": observing(_given(fields.Get, lambda given: tuning.get(given.keys))),
            "diff": observing(_given(fields.Nothing, lambda _: tuning.diff())),
            "log": observing(_given(fields.Last, lambda given: asyncio.to_thread(self._trail.last, given.last))),
            "learn_status": observing(_looking(fields.Nothing, lambda _: self._learning().status())),
            "candidate_show": observing(_looking(fields.Nothing, lambda _: tuning.candidate_show())),
            "analyse_live": operating(self._analyse_live),
            "move": operating(self._move),
            **{name: operating(noted(self._trail, act), stops=name in stops) for name, act in operations.items()},
        }
        return {name: verb if name.startswith("recording_") else self._heard(verb) for name, verb in verbs.items()}

    def _heard(self, verb: Verb) -> Verb:
        """The same; `operated` hears of it where it takes the right to operate. To record is not to operate a cell."""

        async def act(request: Request) -> Any:
            if verb.right(request) is Right.OPERATE:
                self._operated(request)
            return await verb.act(request)

        return replace(verb, act=act)

    async def ask(self, verb: str, peer: Peer) -> Any:
        """The answer to a verb without fields, asked in the name of `peer`, and noted as any other."""
        return await self.table()[verb](Request(verb, {}, peer))

    async def follow_trials(self) -> None:
        """As long as it runs: notice what the loop has decided of a promoted tuning, tell it, and write it down."""
        while True:
            await self.follow()
            await asyncio.sleep(_LOOK_S)

    async def follow(self) -> None:
        """Notice the end of a trial and note it in the audit trail, in the name of the loop."""
        self._tuning.notice()
        while self._outcomes:
            outcome = self._outcomes.popleft()
            await self._trail.note(_LOOP, outcome.verb, outcome.changed)

    def _happened(self, outcome: Outcome) -> None:
        self._outcomes.append(outcome)
        self._say(outcome.told)

    def _answer_status(self) -> status_reply.Status:
        self._tuning.notice()
        return self._status()

    def _configuration(self) -> replies.RunningConfiguration:
        source = self._controller.prepared.source
        return replies.RunningConfiguration(text=source.text, sha256=source.hash)

    async def _learn_reset(self, given: fields.Forget) -> tuple[None, Sequence[Change]]:
        return None, await self._learning().reset(given.axes)

    def _learning(self) -> LearningService:
        if self.learning is None:
            raise CheckFailed("nothing is learned: the configuration has no section learning")
        return self.learning

    async def _jog(self, request: Request) -> tuple[replies.Jogged, Sequence[Change]]:
        given = request.read(fields.JogTo)
        jogged, moved = await self._tuning.jog(given.axis, by_um=given.by_um, to_um=given.to_um)
        return jogged, [moved]

    async def _analyse_live(self, request: Request) -> Any:
        given = request.read(fields.Inject)
        if given.number is not None:
            return self._tuning.injected(given.number)
        return await noted(self._trail, self._inject)(request)

    async def _inject(self, request: Request) -> tuple[replies.Injected, Sequence[Change]]:
        given = request.read(fields.Inject)
        injected = await self._tuning.inject(str(given.axis), given.loop, given.amplitude_um, given.seed)
        what = f"{given.loop} loop measured with {given.amplitude_um:g} um rms"
        return injected, [Change(key=f"axes.{given.axis}", old=None, new=what)]

    async def _move(self, request: Request) -> Any:
        if "number" in request.fields:
            look = request.read(fields.MoveLook)
            return self._tuning.moved(look.number, stop=look.stop)
        return await noted(self._trail, self._begin_move)(request)

    async def _begin_move(self, request: Request) -> tuple[replies.Moved, Sequence[Change]]:
        given = request.read(fields.Moves)
        wanted = MoveRequest.model_validate(given.model_dump(exclude={"axis"}))
        moved = await self._tuning.move(given.axis, wanted)
        what = ", ".join(f"{name} {value}" for name, value in request.fields.items() if name != "axis")
        return moved, [Change(key=f"axes.{given.axis}", old=None, new=f"moved: {what}")]

    async def _recording_start(self, request: Request) -> tuple[status_reply.Recorded, Sequence[Change]]:
        given = request.read(fields.RecordStart)
        extent = Extent(given.before_s, given.segment_s, given.quota_bytes)
        begun = await self._recordings.start(given.file, extent)
        return begun, [Change(key="recording", old=None, new=begun["file"])]

    async def _recording_stop(self, request: Request) -> tuple[status_reply.Recorded, Sequence[Change]]:
        request.read(fields.Nothing)
        ended = await self._recordings.stop()
        return ended, [Change(key="recording", old=ended["file"], new=None)]

    async def _recording_mark(self, request: Request) -> tuple[replies.Marked, Sequence[Change]]:
        marked = self._recordings.mark(request.read(fields.RecordMark).text, request.peer.user)
        return marked, [Change(key="mark", old=None, new=marked["text"])]

    def _commanded(self, command: int) -> Operation:
        async def operation(request: Request) -> tuple[None, Sequence[Change]]:
            request.read(fields.Nothing)
            before = self._controller.state
            if command == states.ARM:
                self._tuning.require_at_rest("arm")
            if command == states.HOLD:
                self._tuning.let_rest()
            if command == states.RESET:
                await self._before_reset()
            await self._controller.command(command)
            return None, [Change(key="state", old=before, new=self._controller.state)]

        return operation
