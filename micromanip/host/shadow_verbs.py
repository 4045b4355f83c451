"""The verbs of shadow tuning, and what is told and noted of a trial that the loop ends by itself."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from pydantic import Field

from micromanip.faults import FaultReport
from micromanip.replies import Change, Shadow
from micromanip.settings.schema.base import Settings
from micromanip.settings.text.source import Source

from .audit import AuditTrail
from .authority import Right
from .candidate import ShadowTuning
from .differences import changes
from .peer import Peer
from .protocol import Act, Nothing, Request, Verb, operating
from .running import Outcome, Running, Tunable

_LOOP = Peer("loop")
_LOOK_S = 0.2


class Offer(Settings):
    """Fields of `shadow`."""

    changes: dict[str, Any] = Field(
        default={}, max_length=200, description="The candidate's values by key; without any: where it stands."
    )


def _right_to_offer(request: Request) -> Right:
    """To see where the last candidate stands is to observe."""
    return Right.OPERATE if request.fields.get("changes") else Right.OBSERVE


class ShadowVerbs:
    """`shadow`, `promote` and `withdraw` of one controller."""

    def __init__(
        self,
        controller: Tunable,
        trail: AuditTrail,
        tell: Callable[[Source], None],
        say: Callable[[str | FaultReport], None],
    ) -> None:
        """`tell` hears of each configuration that has come into force; `say` gets messages for people."""
        self._trail, self._say = trail, say
        self._outcomes: deque[Outcome] = deque()
        self.running = Running(controller, tell, self._happened)
        self._tuning = ShadowTuning(self.running)

    def table(self) -> dict[str, Verb]:
        """Its verbs by name."""
        return {
            "shadow": Verb(self._shadow, _right_to_offer),
            "promote": operating(self._asked(self._tuning.promote)),
            "withdraw": operating(self._asked(self._tuning.withdraw)),
        }

    async def follow_trials(self) -> None:
        """As long as it runs: notice what the loop has decided of a promoted tuning, tell it, and write it down."""
        while True:
            await self.follow()
            await asyncio.sleep(_LOOK_S)

    async def follow(self) -> None:
        """Notice the end of a trial and note it in the audit trail, in the name of the loop."""
        self.running.notice()
        while self._outcomes:
            outcome = self._outcomes.popleft()
            await self._trail.note(_LOOP, outcome.verb, outcome.changed)

    def _happened(self, outcome: Outcome) -> None:
        self._outcomes.append(outcome)
        self._say(outcome.told)

    async def _shadow(self, request: Request) -> Shadow:
        wanted = request.read(Offer).changes
        if not wanted:
            return self._tuning.standing()

        async def change() -> tuple[Shadow, Sequence[Change]]:
            shadow = await self._tuning.offer(wanted)
            return shadow, shadow["changed"]

        return await self._trail.done(request.peer, "shadow", change)

    def _asked(self, act: Callable[[], Awaitable[Shadow]]) -> Act:
        async def change() -> tuple[Shadow, Sequence[Change]]:
            before, running = self._tuning.standing()["standing"], self.running.prepared.configuration
            shadow = await act()
            step = Change(key="candidate", old=before, new=shadow["standing"])
            return shadow, [step, *changes(running, self.running.prepared.configuration)]

        async def verb(request: Request) -> Shadow:
            request.read(Nothing)
            return await self._trail.done(request.peer, request.verb, change)

        return verb
