"""Arming by the configuration: once, after READY, as soon as every sensor has sent a valid sample."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Any

from micromanip.errors import CheckFailed
from micromanip.replies import Change
from micromanip.rt import states

from .control.request import Request
from .controller import Controller
from .refusals import Refused

_LOOK_S = 0.05
"""Nobody presses and releases an emergency stop, or opens and closes a guard, between two looks."""


class ArmOnStart:
    """The arming that a configuration asks for with ``arm_on_start``.

    A device may boot more slowly than the controller: its first samples are waited for, `start.arm_within_s` at most,
    and that is said. Nothing is waited out that a person could rely on: a line that says no, a fault or a lost link
    ends the waiting, and whoever operates the cell meanwhile has it (`leave_to`). Then only `arm` arms.
    """

    def __init__(self, controller: Controller, note: Callable[..., Awaitable[None]], say: Callable[[str], Any]) -> None:
        """`note` writes what was changed, or why nothing was, into the audit trail; `say` gets messages for people."""
        self._controller, self._note, self._say = controller, note, say
        self._left_to: str | None = None
        self.experiments = False
        """Whether it arms variants of the cell, one after another; in READY between two nobody else may."""
        self.awaits: list[str] | None = None
        """What is waited for, a sentence each; None where nothing is."""

    def leave_to(self, request: Request) -> None:
        """Somebody operates the cell: whether it is armed is theirs to say from now on. Raises Refused."""
        if self.experiments and request.verb == "arm":
            raise Refused("experiments are made with this cell, they arm it themselves: `micromanip disarm` ends them")
        self._left_to = self._left_to or f"`{request.verb}` of {request.peer.user}"

    async def arm(self, ends: Callable[[], bool]) -> None:
        """Arm, unless the cell is somebody's by now, or the run `ends` before.

        Raises CheckFailed where arming is refused for another reason than samples to come, or these do not come.
        """
        within_s = self._controller.prepared.configuration.start.arm_within_s
        end = time.monotonic() + within_s
        try:
            while not ends() and self._left_to is None:
                before = self._controller.state
                try:
                    await self._controller.command(states.ARM)  # who operates from here on is served after it
                except Refused as refusal:
                    await self._judge(refusal, within_s, late=time.monotonic() >= end)
                else:
                    await self._note([Change(key="state", old=before, new=self._controller.state)])
                    return
                await asyncio.sleep(_LOOK_S)
        finally:
            self.awaits = None
        if self._left_to is not None:
            self._say(f"arm_on_start is called off by {self._left_to}: only `micromanip arm` arms now")

    async def _judge(self, refusal: Refused, within_s: float, *, late: bool) -> None:
        """Go on waiting and say for what, or raise CheckFailed."""
        if late or refusal.awaits is None:
            why = f"arm_on_start: {refusal}" + f" (gave up after {within_s:g} s)" * bool(late and within_s)
            await self._note([], why)
            raise CheckFailed(why)
        if self.awaits is None:
            self._say(
                f"WARNING: arms by itself as soon as it can, within {within_s:g} s: `micromanip disarm` calls it off. "
                f"It waits: {'; '.join(refusal.awaits)}"
            )
        self.awaits = refusal.awaits
