"""What a client can ask of a running controller, and what is noted of it in the audit trail."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from micromanip.faults import FaultReport
from micromanip.quantities import Micrometres
from micromanip.replies import Audit, Change, Jogged, Saved, Status, Swap
from micromanip.rt import states
from micromanip.settings.schema.base import Flag, Settings
from micromanip.settings.text.source import Source

from .audit import AuditTrail
from .peer import Peer
from .protocol import Act, Nothing, Request, Verb, observing, operating
from .running import Tunable
from .shadow_verbs import ShadowVerbs
from .tuning import Tuning


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


class Last(Settings):
    """Fields of `audit`."""

    last: Annotated[int, Field(strict=True, ge=1, le=1000)] = Field(default=20, description="How many entries.")


class Verbs:
    """The verbs of one controller."""

    def __init__(
        self,
        controller: Tunable,
        trail: AuditTrail,
        status: Callable[[], Status],
        before_reset: Callable[[], Awaitable[None]],
        tell: Callable[[Source], None],
        say: Callable[[str | FaultReport], None],
    ) -> None:
        """`before_reset` returns when what is known of a fault is kept, or raises CheckFailed: not yet.

        `tell` hears of each configuration that has come into force; `say` gets messages for people.
        """
        self._before_reset = before_reset
        self._controller, self._trail, self._status = controller, trail, status
        self.shadow = ShadowVerbs(controller, trail, tell, say)
        self._tuning = Tuning(self.shadow.running)

    def table(self) -> dict[str, Verb]:
        """Every verb by its name."""
        verbs = {
            "status": observing(self._answer_status),
            "get": observing(self._get),
            "diff": observing(self._diff),
            "audit": observing(self._audit),
            "set": operating(self._set),
            "save": operating(self._save),
            "reload": operating(self._reload),
            "jog": operating(self._jog),
            "arm": operating(self._commanded(states.ARM)),
            "disarm": operating(self._commanded(states.DISARM), stops=True),
            "hold": operating(self._commanded(states.HOLD), stops=True),
            "reset": operating(self._commanded(states.RESET)),
            **self.shadow.table(),
        }
        return {name: self._trail.followed(verb) for name, verb in verbs.items()}

    async def command(self, command: int, peer: Peer) -> None:
        """Give a command in the name of `peer`, and note it."""
        async with self._trail.refusals(peer, states.COMMAND_NAMES[command]):
            await self._commanded_by(peer, command)

    async def reload(self, peer: Peer) -> Swap:
        """Take over the configuration file in the name of `peer`, and note it."""
        async with self._trail.refusals(peer, "reload"):
            return await self._reloaded_by(peer)

    async def _reloaded_by(self, peer: Peer) -> Swap:
        async def change() -> tuple[Swap, Sequence[Change]]:
            swap = await self._tuning.reload()
            return swap, swap["changed"]

        return await self._trail.done(peer, "reload", change)

    async def _answer_status(self, request: Request) -> Status:
        request.read(Nothing)
        self.shadow.running.notice()
        return self._status()

    async def _get(self, request: Request) -> Any:
        return await self._tuning.get(request.read(Get).keys)

    async def _diff(self, request: Request) -> Any:
        request.read(Nothing)
        return await self._tuning.diff()

    async def _audit(self, request: Request) -> Audit:
        return await asyncio.to_thread(self._trail.last, request.read(Last).last)

    async def _set(self, request: Request) -> Swap:
        wanted = request.read(Set).changes

        async def change() -> tuple[Swap, Sequence[Change]]:
            swap = await self._tuning.set(wanted)
            return swap, swap["changed"]

        return await self._trail.done(request.peer, "set", change)

    async def _save(self, request: Request) -> Saved:
        force = request.read(Save).force

        async def change() -> tuple[Saved, Sequence[Change]]:
            saved = await self._tuning.save(force=force)
            return saved, saved["changed"]

        return await self._trail.done(request.peer, "save", change)

    async def _reload(self, request: Request) -> Swap:
        request.read(Nothing)
        return await self._reloaded_by(request.peer)

    async def _jog(self, request: Request) -> Jogged:
        fields = request.read(JogTo)

        async def change() -> tuple[Jogged, Sequence[Change]]:
            jogged, moved = await self._tuning.jog(fields.axis, by_um=fields.by_um, to_um=fields.to_um)
            return jogged, [moved]

        return await self._trail.done(request.peer, "jog", change)

    def _commanded(self, command: int) -> Act:
        async def act(request: Request) -> None:
            request.read(Nothing)
            await self._commanded_by(request.peer, command)

        return act

    async def _commanded_by(self, peer: Peer, command: int) -> None:
        async def change() -> tuple[None, Sequence[Change]]:
            before = self._controller.state
            if command == states.RESET:
                await self._before_reset()
            await self._controller.command(command)
            return None, [Change(key="state", old=before, new=self._controller.state)]

        await self._trail.done(peer, states.COMMAND_NAMES[command], change)
