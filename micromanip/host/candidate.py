"""Shadow tuning, the host's side: offer a candidate, compare it, promote it, take it back."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from micromanip.errors import CheckFailed
from micromanip.replies import Shadow
from micromanip.rt.states import (
    NO_SHADOW,
    ON_TRIAL,
    PROMOTE,
    SHADOW_NAMES,
    SHADOWING,
    STATE_NAMES,
    TRACKING,
    WITHDRAW,
)
from micromanip.settings.text.keys import assigned
from micromanip.settings.text.place import Path as KeyPath
from micromanip.settings.text.source import Source, key_text

from .comparison import comparison, passed_s, trial, trial_s
from .running import Running


class ShadowTuning:
    """The candidate of one controller."""

    def __init__(self, running: Running) -> None:
        self._running = running

    async def offer(self, wanted: Mapping[str, Any]) -> Shadow:
        """Let what runs, but with other values of some keys, compute beside it; errors as those of `Tuning.set`."""
        running = self._running
        async with running.changing():
            self._refuse_unless_tracking("shadow")
            running.refuse_on_trial()
            known = running.prepared.configuration.model_dump(mode="json")
            document = await asyncio.to_thread(assigned, running.document, known, wanted)
            candidate, _ = await running.revised(Source.of(document, running.file.path), _refuse)
            self._refuse_unless_tracking("shadow")
            version = await running.controller.offer(candidate.parameters)
            running.offered(version, candidate, document)
            return self._standing()

    async def promote(self) -> Shadow:
        """Put the candidate in force, on trial; CheckFailed where there is none, or nothing is tracked."""
        running = self._running
        async with running.changing():
            standing = SHADOWING if running.candidate is None else running.candidate.standing
            if running.candidate is None or standing != SHADOWING:
                there = f"the last one is {SHADOW_NAMES[standing]}" if running.candidate else "there is none"
                raise CheckFailed(f"promote refused: {there}; `micromanip shadow KEY=VALUE` offers a candidate")
            self._refuse_unless_tracking("promote")
            await running.controller.command(PROMOTE)
        return self.standing()

    async def withdraw(self) -> Shadow:
        """Let the candidate go, or take it back where it is on trial; CheckFailed where there is neither."""
        running = self._running
        async with running.changing():
            candidate = running.candidate
            if candidate is None or candidate.standing not in (SHADOWING, ON_TRIAL):
                there = f"the last one is {SHADOW_NAMES[candidate.standing]}" if candidate else "there is none"
                raise CheckFailed(f"withdraw refused: {there}; nothing to withdraw")
            candidate.withdrawn = True
            try:
                await running.controller.command(WITHDRAW)
            except CheckFailed:
                candidate.withdrawn = False  # the loop was quicker, and has a reason of its own
                raise
            if candidate.standing == SHADOWING:
                running.candidate = None
        return self.standing()

    def standing(self) -> Shadow:
        """Where the candidate stands, with its figures."""
        self._running.notice()
        return self._standing()

    def _standing(self) -> Shadow:
        candidate, status = self._running.candidate, self._running.controller.status
        if candidate is None:
            return Shadow(
                standing=SHADOW_NAMES[NO_SHADOW],
                version=None,
                changed=[],
                comparison={},
                trial={},
                passed_s=None,
                trial_s=None,
                reason=None,
            )
        parameters, axes = candidate.prepared.parameters, list(candidate.prepared.configuration.axes)
        promoted = candidate.standing != SHADOWING
        return Shadow(
            standing=SHADOW_NAMES[candidate.standing],
            version=candidate.version,
            changed=candidate.changed,
            comparison={} if promoted else comparison(status, parameters, axes),
            trial=trial(status, parameters, axes) if promoted else {},
            passed_s=passed_s(status, parameters) if promoted else None,
            trial_s=trial_s(parameters),
            reason=candidate.reason,
        )

    def _refuse_unless_tracking(self, verb: str) -> None:
        state = self._running.controller.state
        if state != STATE_NAMES[TRACKING]:
            raise CheckFailed(f"{verb} refused: the state is {state}; a candidate is compared while TRACKING")


def _refuse(wanted: Mapping[KeyPath, str]) -> None:
    """Raise CheckFailed for changes that are more than live."""
    if wanted:
        reasons = "; ".join(f"{key_text(path)} {what}" for path, what in wanted.items())
        raise CheckFailed(f"nothing was changed, a candidate takes live values only: {reasons}")
