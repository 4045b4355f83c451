"""What a client can ask of a running controller, and what is noted of it in the audit trail."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from micromanip.errors import CheckFailed, MicromanipError
from micromanip.faults import FaultReport
from micromanip.host.recording.recording import Extent
from micromanip.host.recording.recordings import Recordings
from micromanip.quantities import Micrometres, Seed
from micromanip.replies import (
    Audit,
    Change,
    Injected,
    Jogged,
    LearningStatus,
    Marked,
    Moved,
    Recorded,
    Response,
    RunningConfiguration,
    Saved,
    Shadow,
    Status,
    Swap,
)
from micromanip.rt import states
from micromanip.rt.part import MOST_TOOLS
from micromanip.rt.record import MAX_AXES
from micromanip.settings.injected import AMPLITUDE_UM
from micromanip.settings.moved import Wanted
from micromanip.settings.schema.base import Flag, Settings
from micromanip.settings.text.source import Source

from ..controller import Controller
from ..learning.keeper import LearningKeeper
from .audit import AuditTrail
from .authority import Peer, Right
from .candidate import Outcome
from .handover import Handed, telemetry
from .server import Act, Nothing, Request, Verb, observing, operating
from .transaction import Tuning

Operation = Callable[[Request], Awaitable[tuple[Any, Sequence[Change]]]]
"""Does what a request asks for; its result, and what it has changed."""

_LOOP = Peer("loop")
_LOOK_S = 0.2


class Get(Settings):
    """Fields of `get`."""

    keys: tuple[str, ...] = Field(default=(), max_length=200, description="Keys or sections; all without one.")


class Set(Settings):
    """Fields of `set`."""

    changes: dict[str, Any] = Field(min_length=1, max_length=200, description="New values by key.")


class Save(Settings):
    """Fields of `save`."""

    force: Flag = Field(default=False, description="Write although the file was changed on disk.")


class JogTo(Settings):
    """Fields of `jog`."""

    axis: str = Field(description="Name of the axis.")
    by_um: Micrometres | None = Field(default=None, description="From its present target.")
    to_um: Micrometres | None = Field(default=None, description="Its new target.")

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.by_um is None) == (self.to_um is None):
            raise ValueError("give either by_um or to_um")
        return self


class Inject(Settings):
    """Fields of `sensitivity`: those of a new measurement, or the number of one that was begun."""

    number: Annotated[int, Field(strict=True, ge=1)] | None = Field(default=None, description="Which one is asked for.")
    axis: str | None = Field(default=None, description="Name of the axis.")
    loop: Literal["strain", "stage"] = Field(default="strain", description="Which of its loops.")
    amplitude_um: Annotated[float, Field(gt=0, le=10)] = Field(
        default=AMPLITUDE_UM,
        description="Rms of the multisine on the set-point.",
    )
    seed: Seed = Field(default=1, description="Draws its phases.")

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.number is None) == (self.axis is None):
            raise ValueError("give either axis, to begin, or number")
        return self


class Moves(Wanted):
    """Fields of `move` that begin one."""

    axis: str = Field(description="Name of the axis.")


class MoveLook(Settings):
    """Fields of `move` for one that was begun."""

    number: Annotated[int, Field(strict=True, ge=1)] = Field(description="Which one is asked for.")
    stop: Flag = Field(default=False, description="Let it come to rest.")


class Last(Settings):
    """Fields of `audit`."""

    last: Annotated[int, Field(strict=True, ge=1, le=1000)] = Field(default=20, description="How many entries.")


class Forget(Settings):
    """Fields of `learn_reset`."""

    axes: tuple[str, ...] = Field(default=(), max_length=MAX_AXES, description="Of these axes; all without one.")


class BeginPart(Settings):
    """Fields of `part_begin`."""

    tool: int | None = Field(default=None, ge=1, le=MOST_TOOLS, description="Number of the tool, where it is told.")


class Offer(Settings):
    """Fields of `shadow`."""

    changes: dict[str, Any] = Field(
        default={}, max_length=200, description="The candidate's values by key; without any: where it stands."
    )


class RecordStart(Settings):
    """Fields of `record_start`."""

    file: str | None = Field(default=None, description="Name in the folder of recordings; without one, the time.")
    triggers: tuple[Literal["fault", "overrun", "mark"], ...] = Field(
        default=(), max_length=3, description="Wait for the first of these."
    )
    before_s: Annotated[float, Field(strict=True, ge=0, le=5, allow_inf_nan=False)] = Field(
        default=0.0, description="Begin so much earlier, s: than now, or than the trigger."
    )
    after_s: Annotated[float, Field(strict=True, ge=0, le=3600, allow_inf_nan=False)] | None = Field(
        default=None, description="End so much later than the trigger, s."
    )
    segment_s: Annotated[float, Field(strict=True, ge=1, le=86_400, allow_inf_nan=False)] | None = Field(
        default=None, description="Begin another file so often, s."
    )
    quota_bytes: Annotated[int, Field(strict=True, ge=1_000_000, le=10**16)] | None = Field(
        default=None, description="Remove the oldest of these files beyond that."
    )

    @model_validator(mode="after")
    def _after_a_trigger(self) -> Self:
        if (self.after_s is None) != (not self.triggers):
            raise ValueError("triggers and after_s go together: how long to record after the first of them")
        if (self.segment_s is None) != (self.quota_bytes is None):
            raise ValueError("segment_s and quota_bytes go together: how long a file is, and how much all may take")
        if self.segment_s is not None and self.triggers:
            raise ValueError("segment_s is for a recording without an end, not for one around triggers")
        return self


class RecordMark(Settings):
    """Fields of `record_mark`."""

    text: str = Field(min_length=1, max_length=500, description="The remark.")


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


def _asked(fields: Mapping[str, Any]) -> list[Change]:
    """What a request wanted: the new values of a `set` or `shadow`, the fields of any other."""
    changes = fields.get("changes")
    wanted = changes if isinstance(changes, Mapping) else fields
    return [Change(key=key, old=None, new=value) for key, value in wanted.items()]


def _right_to_shadow(request: Request) -> Right:
    """To see where the last candidate stands is to observe."""
    return Right.OPERATE if request.fields.get("changes") else Right.OBSERVE


class Verbs:
    """The verbs of one controller."""

    def __init__(
        self,
        controller: Controller,
        trail: AuditTrail,
        status: Callable[[], Status],
        before_reset: Callable[[], Awaitable[None]],
        tell: Callable[[Source], None],
        say: Callable[[str | FaultReport], None],
        recordings: Recordings,
    ) -> None:
        """`before_reset` returns when what is known of a fault is kept, or raises CheckFailed: not yet.

        `tell` hears of each configuration that has come into force; `say` gets messages for people.
        """
        self._before_reset, self._say, self._recordings = before_reset, say, recordings
        self._controller, self._trail, self._status = controller, trail, status
        self._outcomes: deque[Outcome] = deque()
        self._tuning = Tuning(controller, tell, self._happened)
        self.put_again = self._tuning.put_again
        self.learning: LearningKeeper | None = None
        """Where the configuration has it."""

    def table(self) -> dict[str, Verb]:
        """Every verb by its name."""
        operations: dict[str, Operation] = {
            "set": self._set,
            "save": self._save,
            "reload": self._reload,
            "jog": self._jog,
            "promote": self._promote,
            "withdraw": self._withdraw,
            "record_start": self._record_start,
            "record_stop": self._record_stop,
            "record_mark": self._record_mark,
            "arm": self._commanded(states.ARM),
            "disarm": self._commanded(states.DISARM),
            "hold": self._commanded(states.HOLD),
            "reset": self._commanded(states.RESET),
            "part_begin": self._part_begin,
            "part_end": self._commanded(states.END_PART),
            "learn_reset": self._learn_reset,
        }
        stops = ("disarm", "hold")
        return {
            "status": observing(self._answer_status),
            "telemetry": observing(self._telemetry),
            "configuration": observing(self._configuration),
            "get": observing(self._get),
            "diff": observing(self._diff),
            "audit": observing(self._audit),
            "learn_status": observing(self._learn_status),
            "shadow": Verb(self._shadow, _right_to_shadow),
            "sensitivity": operating(self._sensitivity),
            "move": operating(self._move),
            **{name: operating(noted(self._trail, act), stops=name in stops) for name, act in operations.items()},
        }

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

    async def _answer_status(self, request: Request) -> Status:
        request.read(Nothing)
        self._tuning.notice()
        return self._status()

    async def _telemetry(self, request: Request) -> Handed:
        request.read(Nothing)
        return telemetry(self._controller)

    async def _configuration(self, request: Request) -> RunningConfiguration:
        request.read(Nothing)
        source = self._controller.prepared.source
        return RunningConfiguration(text=source.text, sha256=source.hash)

    async def _get(self, request: Request) -> Any:
        return await self._tuning.get(request.read(Get).keys)

    async def _diff(self, request: Request) -> Any:
        request.read(Nothing)
        return await self._tuning.diff()

    async def _audit(self, request: Request) -> Audit:
        return await asyncio.to_thread(self._trail.last, request.read(Last).last)

    async def _learn_status(self, request: Request) -> LearningStatus:
        request.read(Nothing)
        return self._keeper().status()

    async def _learn_reset(self, request: Request) -> tuple[None, Sequence[Change]]:
        return None, await self._keeper().reset(request.read(Forget).axes)

    async def _part_begin(self, request: Request) -> tuple[None, Sequence[Change]]:
        tool, changed = request.read(BeginPart).tool, []
        if tool is not None or self.learning is not None:
            changed = await self._keeper().state_tool(tool or 0)
        before = self._controller.state
        try:
            await self._controller.command(states.BEGIN_PART)
        except CheckFailed:
            for change in changed:
                with contextlib.suppress(CheckFailed):  # why the part was refused matters more
                    await self._keeper().state_tool(change["old"])
            raise
        return None, [*changed, Change(key="state", old=before, new=self._controller.state)]

    def _keeper(self) -> LearningKeeper:
        if self.learning is None:
            raise CheckFailed("nothing is learned: the configuration has no section learning")
        return self.learning

    async def _set(self, request: Request) -> tuple[Swap, Sequence[Change]]:
        swap = await self._tuning.set(request.read(Set).changes)
        return swap, swap["changed"]

    async def _save(self, request: Request) -> tuple[Saved, Sequence[Change]]:
        saved = await self._tuning.save(force=request.read(Save).force)
        return saved, saved["changed"]

    async def _reload(self, request: Request) -> tuple[Swap, Sequence[Change]]:
        request.read(Nothing)
        swap = await self._tuning.reload()
        return swap, swap["changed"]

    async def _jog(self, request: Request) -> tuple[Jogged, Sequence[Change]]:
        fields = request.read(JogTo)
        jogged, moved = await self._tuning.jog(fields.axis, by_um=fields.by_um, to_um=fields.to_um)
        return jogged, [moved]

    async def _sensitivity(self, request: Request) -> Injected | Response:
        fields = request.read(Inject)
        if fields.number is not None:
            return self._tuning.injected(fields.number)
        injected: Injected = await noted(self._trail, self._inject)(request)
        return injected

    async def _inject(self, request: Request) -> tuple[Injected, Sequence[Change]]:
        fields = request.read(Inject)
        injected = await self._tuning.inject(str(fields.axis), fields.loop, fields.amplitude_um, fields.seed)
        what = f"{fields.loop} loop measured with {fields.amplitude_um:g} um rms"
        return injected, [Change(key=f"axes.{fields.axis}", old=None, new=what)]

    async def _move(self, request: Request) -> Moved:
        if "number" in request.fields:
            look = request.read(MoveLook)
            return self._tuning.moved(look.number, stop=look.stop)
        moved: Moved = await noted(self._trail, self._begin_move)(request)
        return moved

    async def _begin_move(self, request: Request) -> tuple[Moved, Sequence[Change]]:
        fields = request.read(Moves)
        wanted = Wanted.model_validate(fields.model_dump(exclude={"axis"}))
        moved = await self._tuning.move(fields.axis, wanted)
        what = ", ".join(f"{name} {value}" for name, value in request.fields.items() if name != "axis")
        return moved, [Change(key=f"axes.{fields.axis}", old=None, new=f"moved: {what}")]

    async def _shadow(self, request: Request) -> Shadow:
        if _right_to_shadow(request) is Right.OPERATE:
            shadow: Shadow = await noted(self._trail, self._offer)(request)
            return shadow
        request.read(Offer)
        return self._tuning.standing()

    async def _offer(self, request: Request) -> tuple[Shadow, Sequence[Change]]:
        shadow = await self._tuning.shadow(request.read(Offer).changes)
        return shadow, shadow["changed"]

    async def _promote(self, request: Request) -> tuple[Shadow, Sequence[Change]]:
        request.read(Nothing)
        return await self._tuning.promote()

    async def _withdraw(self, request: Request) -> tuple[Shadow, Sequence[Change]]:
        request.read(Nothing)
        return await self._tuning.withdraw()

    async def _record_start(self, request: Request) -> tuple[Recorded, Sequence[Change]]:
        fields = request.read(RecordStart)
        ends = fields.triggers, fields.after_s or 0.0
        extent = Extent(fields.before_s, *ends, fields.segment_s, fields.quota_bytes)
        begun = await self._recordings.start(fields.file, extent)
        return begun, [Change(key="recording", old=None, new=begun["file"])]

    async def _record_stop(self, request: Request) -> tuple[Recorded, Sequence[Change]]:
        request.read(Nothing)
        ended = await self._recordings.stop()
        return ended, [Change(key="recording", old=ended["file"], new=None)]

    async def _record_mark(self, request: Request) -> tuple[Marked, Sequence[Change]]:
        marked = self._recordings.mark(request.read(RecordMark).text, request.peer.user)
        return marked, [Change(key="mark", old=None, new=marked["text"])]

    def _commanded(self, command: int) -> Operation:
        async def operation(request: Request) -> tuple[None, Sequence[Change]]:
            request.read(Nothing)
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
