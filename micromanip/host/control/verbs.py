"""What a client can ask of a running controller, and what is noted of it in the audit trail."""

from __future__ import annotations

import asyncio
import inspect
import os
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from micromanip import replies, status_reply
from micromanip.errors import CheckFailed, MicromanipError
from micromanip.faults import FaultReport
from micromanip.host.recording.recordings import Recordings
from micromanip.replies import Change
from micromanip.rt import states
from micromanip.rt.telemetry import ROW
from micromanip.settings.move_plan import MoveRequest
from micromanip.settings.schema.base import Settings
from micromanip.settings.text.source import Source

from ..controller import Controller
from ..learning.service import LearningService
from ..shared_memory import CONTROL, STATUS, columns
from . import fields
from .answers import Outcome
from .audit import AuditTrail
from .authority import Peer, Right
from .request import Request, Verb
from .server import Handed
from .transaction import Tuning

_LOOP = Peer("loop")
_LOOK_S = 0.2
Done = tuple[Any, Sequence[Change]]
"""What a verb answers, and what it has changed."""


@dataclass(frozen=True)
class Row:
    """One verb: what it is given, and what is done with that; in the audit trail where it `operates`.

    What `do` returns is `Done`, or a reply that says itself what it has `changed`.
    """

    given: type[Settings]
    do: Callable[..., Any]
    operates: bool = True
    stops: bool = False
    signed: bool = False
    """`do` is told who asks, too."""
    look: Row | None = None
    """What is done instead for a request with the `number` of something that was begun: it changes nothing."""


_observing = partial(Row, operates=False)


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
        self._tuning = tuning = Tuning(controller, tell, self._happened)
        self.put_again = tuning.put_again
        self.learning: LearningService | None = None
        """Where the configuration has it."""
        nothing = fields.Nothing
        self._rows = {
            "status": _observing(nothing, self._answer_status),
            "telemetry": _observing(nothing, lambda: _telemetry(controller)),
            "configuration": _observing(nothing, self._configuration),
            "get": _observing(fields.Get, lambda given: tuning.get(given.keys)),
            "diff": _observing(nothing, tuning.diff),
            "log": _observing(fields.Last, lambda given: asyncio.to_thread(trail.last, given.last)),
            "learn_status": _observing(nothing, lambda: self._learning().status()),
            "candidate_show": _observing(nothing, tuning.candidate_show),
            "set": Row(fields.Set, lambda given: tuning.set(given.changes)),
            "save": Row(fields.Save, lambda given: tuning.save(force=given.force)),
            "reload": Row(nothing, tuning.reload),
            "jog": Row(fields.JogTo, lambda given: tuning.jog(given.axis, by_um=given.by_um, to_um=given.to_um)),
            "candidate_set": Row(fields.Set, lambda given: tuning.candidate_set(given.changes)),
            "candidate_promote": Row(nothing, tuning.candidate_promote),
            "candidate_discard": Row(nothing, tuning.candidate_discard),
            "recording_start": Row(fields.RecordStart, self._recording_start),
            "recording_stop": Row(nothing, self._recording_stop),
            "recording_mark": Row(fields.RecordMark, self._recording_mark, signed=True),
            "arm": Row(nothing, partial(self._command, states.ARM)),
            "disarm": Row(nothing, partial(self._command, states.DISARM), stops=True),
            "hold": Row(nothing, partial(self._command, states.HOLD), stops=True),
            "reset": Row(nothing, partial(self._command, states.RESET)),
            "learn_part_begin": Row(nothing, partial(self._command, states.BEGIN_PART)),
            "learn_part_end": Row(nothing, partial(self._command, states.END_PART)),
            "learn_reset": Row(fields.Forget, self._learn_reset),
            "analyse_live": Row(
                fields.Inject,
                self._analyse_live,
                look=_observing(fields.Look, lambda given: tuning.injecting.look(given.number)),
            ),
            "move": Row(
                fields.Moves,
                self._move,
                look=_observing(fields.MoveLook, lambda given: tuning.moving.look(given.number, stop=given.stop)),
            ),
        }

    def table(self) -> dict[str, Verb]:
        """Every verb by its name."""
        return {
            name: Verb(partial(self._dispatch, row), Right.OPERATE if row.operates else Right.OBSERVE, row.stops)
            for name, row in self._rows.items()
        }

    async def _dispatch(self, row: Row, request: Request) -> Any:
        """The answer; the trail gets what was changed, or what was asked for and why it was not done."""
        if row.operates and not request.verb.startswith("recording_"):  # to record is not to operate a cell
            self._operated(request)
        if row.look is not None and "number" in request.fields:
            row = row.look
        try:
            given, signed = request.read(row.given), [request.peer] * row.signed
            done = row.do(*signed) if row.given is fields.Nothing else row.do(given, *signed)
            done = await done if inspect.isawaitable(done) else done
        except Exception as problem:
            if row.operates:
                why = str(problem)
                why = why if isinstance(problem, MicromanipError) else f"bug: {type(problem).__name__}: {why}"
                await self._trail.note(request.peer, request.verb, _asked(request.fields), why)
            raise
        if not row.operates:
            return done
        answer, changes = done if isinstance(done, tuple) else (done, done["changed"])
        await self._trail.note(request.peer, request.verb, changes)
        return answer

    async def ask(self, verb: str, peer: Peer) -> Any:
        """The answer to a verb without fields, asked in the name of `peer`, and noted as any other."""
        return await self._dispatch(self._rows[verb], Request(verb, {}, peer))

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

    async def _learn_reset(self, given: fields.Forget) -> Done:
        return None, await self._learning().reset(given.axes)

    def _learning(self) -> LearningService:
        if self.learning is None:
            raise CheckFailed("nothing is learned: the configuration has no section learning")
        return self.learning

    async def _analyse_live(self, given: fields.Inject) -> Done:
        injected = await self._tuning.inject(given.axis, given.loop, given.amplitude_um, given.seed)
        what = f"{given.loop} loop measured with {given.amplitude_um:g} um rms"
        return injected, [Change(key=f"axes.{given.axis}", old=None, new=what)]

    async def _move(self, given: fields.Moves) -> Done:
        wanted = given.model_dump(exclude={"axis"}, exclude_unset=True)
        moved = await self._tuning.move(given.axis, MoveRequest.model_validate(wanted))
        what = ", ".join(f"{name} {value}" for name, value in wanted.items())
        return moved, [Change(key=f"axes.{given.axis}", old=None, new=f"moved: {what}")]

    async def _recording_start(self, given: fields.RecordStart) -> Done:
        begun = await self._recordings.start(given.file, given)
        return begun, [Change(key="recording", old=None, new=begun["file"])]

    async def _recording_stop(self) -> Done:
        ended = await self._recordings.stop()
        return ended, [Change(key="recording", old=ended["file"], new=None)]

    def _recording_mark(self, given: fields.RecordMark, peer: Peer) -> Done:
        marked = self._recordings.mark(given.text, peer.user)
        return marked, [Change(key="mark", old=None, new=marked["text"])]

    async def _command(self, command: int) -> Done:
        before = self._controller.state
        if command == states.ARM:
            self._tuning.moving.require_none("arm refused")
        if command == states.HOLD:
            self._tuning.moving.stop("hold was asked for")
        if command == states.RESET:
            await self._before_reset()
        await self._controller.command(command)
        return None, [Change(key="state", old=before, new=self._controller.state)]


def _telemetry(controller: Controller) -> Handed:
    """Read-only descriptors of the loop's status, its ring and its parameters, in this order, and what they hold.

    Whoever may observe maps them for reading and nothing else; the loop does not notice who has mapped what.
    """
    configuration = controller.prepared.configuration
    segments = controller.segments
    limiters = controller.prepared.parameters[0]["axis"]["limiter"]
    told = replies.Telemetry(
        axes=list(configuration.axes),
        drivers=list(configuration.drivers),
        range_V={
            axis: [float(limiters[i]["low_V"]), float(limiters[i]["high_V"])]
            for i, axis in enumerate(configuration.axes)
        },
        period_ns=configuration.loop.period_ns,
        status_bytes=STATUS.itemsize,
        row_bytes=ROW.itemsize,
        control_bytes=CONTROL.itemsize,
        columns=columns(),
    )
    found: list[int] = []
    try:
        for segment in (segments.status, segments.ring, segments.control):
            found.append(segment.read_only())  # noqa: PERF401 (what was opened is closed where one fails)
    except OSError:
        for descriptor in found:
            os.close(descriptor)
        raise
    return Handed(told, tuple(found))
