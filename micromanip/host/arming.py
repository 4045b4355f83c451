"""The host's own arming: in the configuration's name, once, after READY; or in an experiment's, again and again."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Any

from micromanip.errors import CheckFailed
from micromanip.replies import Change
from micromanip.rt import states
from micromanip.settings.schema.model import ARMS_WITHIN_S

from .control.request import Request
from .controller import Controller
from .refusals import Refused

_LOOK_S = 0.05
"""Nobody presses and releases an emergency stop, or opens and closes a guard, between two looks."""


class HostArming:
    """Arms as soon as every sensor has sent a valid sample.

    Nothing is waited out that a person could rely on: a line that says no, a fault or a lost link ends the waiting, and
    whoever operates the cell meanwhile has it (`leave_to`). Then only `arm` arms.
    """

    def __init__(
        self,
        controller: Controller,
        note: Callable[..., Awaitable[None]],
        say: Callable[[str], Any],
        *,
        experiments: bool = False,
    ) -> None:
        """`note` writes what was changed, or why nothing was, into the audit trail; `say` gets messages for people.

        With `experiments` it arms variants of the cell, one after another; in READY between two nobody else may.
        """
        self._controller, self._note, self._say, self._experiments = controller, note, say, experiments
        self._left_to: str | None = None

    def leave_to(self, request: Request) -> None:
        """Somebody operates the cell: whether it is armed is theirs to say from now on. Raises Refused."""
        if self._experiments and request.verb == "arm":
            raise Refused("experiments are made with this cell, they arm it themselves: `micromanip disarm` ends them")
        self._left_to = self._left_to or f"`{request.verb}` of {request.peer.user}"

    async def arm(self, ends: Callable[[], bool]) -> None:
        """Arm, unless the cell is somebody's by now, or the run `ends` before.

        Raises CheckFailed where arming is refused for another reason than samples to come, or these do not come.
        """
        end, told = time.monotonic() + ARMS_WITHIN_S, False
        while not ends() and self._left_to is None:
            before = self._controller.state
            try:
                await self._controller.command(states.ARM)  # who operates from here on is served after it
            except Refused as refusal:
                await self._judge(refusal, late=time.monotonic() >= end)
                if not told:
                    self._say(
                        f"WARNING: arms by itself as soon as it can, within {ARMS_WITHIN_S:g} s: `micromanip disarm` "
                        f"calls it off. It waits: {'; '.join(refusal.awaits or ())}"
                    )
                told = True
            else:
                await self._note([Change(key="state", old=before, new=self._controller.state)])
                return
            await asyncio.sleep(_LOOK_S)
        if self._left_to is not None:
            self._say(f"arming is called off by {self._left_to}: only `micromanip arm` arms now")

    async def _judge(self, refusal: Refused, *, late: bool) -> None:
        """Raise CheckFailed where it is not to be waited any longer."""
        if late or refusal.awaits is None:
            why = f"{refusal}" + f" (gave up after {ARMS_WITHIN_S:g} s)" * late
            await self._note([], why)
            raise CheckFailed(why)
