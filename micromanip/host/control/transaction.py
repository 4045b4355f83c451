"""What is in force in one controller, and the one way to change it: whole at one cycle boundary, or not at all.

`set`, `jog`, `reload` and `candidate_set` are one transaction (`Tuning._transact`): what was asked for is a document;
it is validated once; what each changed key takes is judged against the state of the cell; the parameters are compiled,
and applied while nobody else can command the loop; whoever keeps what runs is told.

One change at a time. What the loop decides by itself, the end of a trial, is noticed before anything else is changed.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from micromanip import replies
from micromanip.errors import CheckFailed, require_axis
from micromanip.replies import Change, Differences, Injected, Jogged, Moved, Parameter, Saved, Swap
from micromanip.rt import mailbox as w
from micromanip.rt.states import (
    CONFIRMED,
    FAULT,
    NO_SHADOW,
    OFF,
    ON_TRIAL,
    PROMOTE,
    READY,
    SHADOW_NAMES,
    SHADOWING,
    STATE_NAMES,
    TAKEN_BACK,
    TRACKING,
    WITHDRAW,
)
from micromanip.settings.change import WEAKENS, demands
from micromanip.settings.check import Prepared, revise, validate, validate_with_options
from micromanip.settings.load import validate_document
from micromanip.settings.move_plan import MoveRequest
from micromanip.settings.schema.key import DISARM
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Jog
from micromanip.settings.text.keys import assigned
from micromanip.settings.text.place import Path as KeyPath
from micromanip.settings.text.source import Source, key_text
from micromanip.settings.wiring.timing import age_is_computed, with_ages
from micromanip.settings.write import write_into

from ..controller import Controller
from .answers import Candidate, Outcome, changes, differences, parameters, report, step, why_taken_back
from .injecting import Injecting
from .moving import Moving

_AT_REST = tuple(STATE_NAMES[state] for state in (OFF, READY, FAULT))
_WHILE_TRACKING = {
    "jog": "an axis is jogged",
    "candidate_set": "a candidate is compared",
    "candidate_promote": "a candidate is compared",
}
_TARGETS = "target_um"
"""Where each axis was sent by hand."""


class Tuning:
    """Values of one running controller, the file that they were read from, and the candidate beside them."""

    def __init__(
        self, controller: Controller, tell: Callable[[Source], None], happened: Callable[[Outcome], None]
    ) -> None:
        """`tell` hears of each configuration that has come into force, or has been written to the file."""
        self._controller, self._announce, self._happened = controller, tell, happened
        self._file = controller.prepared.source
        self._candidate: Candidate | None = None
        self._one_at_a_time = asyncio.Lock()
        self.injecting = Injecting(controller)
        self.moving = Moving(controller)

    @property
    def _prepared(self) -> Prepared:
        return self._controller.prepared

    async def get(self, keys: Sequence[str]) -> list[Parameter]:
        """Running values of `keys`, of all below where one is a section; all values without keys."""
        self.notice()
        return await asyncio.to_thread(parameters, self._prepared, keys)

    async def diff(self) -> Differences:
        """The file on disk against what runs; ConfigError where the file is not valid as it is."""
        source = await asyncio.to_thread(Source.read, self._file.path)
        on_disk = with_ages(await asyncio.to_thread(validate, source), self._prepared.wiring)
        self.notice()
        return Differences(
            file=str(source.path),
            changed_on_disk=source.hash != self._file.hash,
            differences=differences(on_disk, self._prepared.configuration),
        )

    async def set(self, wanted: Mapping[str, Any]) -> Swap:
        """Change the values of some keys; UsageError, ConfigError or CheckFailed says each reason why not."""
        async with self._changing():
            return await self._swap("set", await self._with(wanted))

    async def jog(self, axis: str, *, by_um: float | None, to_um: float | None) -> tuple[Jogged, list[Change]]:
        """Send `axis` to another target while TRACKING; CheckFailed or ConfigError says why not."""
        async with self._changing():
            configuration = self._prepared.configuration
            reference = configuration.reference
            if not isinstance(reference, Jog):
                raise CheckFailed(f"jog refused: reference.source is {reference.source}, not jog")
            require_axis(axis, configuration.axes)
            present_um = reference.target_um.get(axis, reference.offset_um)
            target_um = present_um + (by_um or 0.0) if to_um is None else to_um
            key = f"reference.target_um.{axis}"
            await self._transact("jog", await self._with({key: target_um}))
            return Jogged(axis=axis, target_um=target_um), [Change(key=key, old=present_um, new=target_um)]

    async def inject(self, axis: str, loop: str, amplitude_um: float, seed: int) -> Injected:
        """Begin to measure the sensitivity of a loop; UsageError or CheckFailed says why not."""
        async with self._changing():
            self._refuse_on_trial()
            if self._candidate is not None and self._candidate.standing == SHADOWING:
                raise CheckFailed("refused: a candidate is compared; `micromanip candidate discard` lets it go")
            return await self.injecting.begin(axis, loop, amplitude_um, seed)

    async def move(self, axis: str, wanted: MoveRequest) -> Moved:
        """Begin to move an axis that is held; UsageError or CheckFailed says why not."""
        async with self._changing():
            self._refuse_on_trial()
            return await self.moving.begin(axis, wanted)

    async def put_again(self, before: Callable[[], None]) -> None:
        """Put what runs in force once more, as the controller adds to it after `before`; CheckFailed where it can't be.

        `before` is called while nobody changes anything else, and no tuning may be taken back.
        """
        async with self._changing():
            self._refuse_on_trial()
            before()
            async with self._controller.commanding():
                await self._controller.inject(self._prepared.parameters)

    async def reload(self) -> Swap:
        """Take over the file as it is now; errors as `set`, and nothing changed where one key of it can't be taken."""
        async with self._changing():
            source = await asyncio.to_thread(Source.read, self._file.path)
            swap = await self._swap("reload", source)
            self._keep(source)
            return swap

    async def candidate_set(self, wanted: Mapping[str, Any]) -> replies.Candidate:
        """Let what runs, but with other values of some keys, compute beside it; errors as those of `set`."""
        async with self._changing():
            candidate, version = await self._transact("candidate_set", await self._with(wanted))
            changed = changes(self._prepared.configuration, candidate.configuration)
            self._candidate = Candidate(version, candidate, changed)
            return report(self._candidate, self._controller.status)

    async def _with(self, wanted: Mapping[str, Any]) -> Source:
        """What runs with other values of some keys, as a document; UsageError where there is no such key."""
        known = self._prepared.configuration.model_dump(mode="json")
        document = await asyncio.to_thread(assigned, self._prepared.source.data, known, wanted)
        return Source.of(document, self._file.path)

    async def _transact(self, verb: str, source: Source) -> tuple[Prepared, int]:
        """Put `source` in force, or for `candidate_set` beside what is; what it was compiled to, and its version."""
        self._refuse_on_trial()
        self._refuse(verb, {})
        prepared, wanted = await asyncio.to_thread(self._judged, verb, source)
        async with self._controller.commanding():  # the state counts at the swap, not when the values were checked
            self._refuse(verb, wanted)
            if verb == "candidate_set":
                return prepared, await self._controller.offer(prepared)
            version = await self._controller.apply(prepared)
        self._announce(prepared.source)
        self._drop_candidate()
        return prepared, version

    def _judged(self, verb: str, source: Source) -> tuple[Prepared, Mapping[KeyPath, str]]:
        """`source` ready to run, and what of its changes is more than live; ConfigError, CheckFailed."""
        configuration = with_ages(validate_with_options(source), self._prepared.wiring)
        wanted = {
            path: what
            for path, what in demands(self._prepared.configuration, configuration).items()
            if not (age_is_computed(self._prepared.source, path) and age_is_computed(source, path))
        }
        self._refuse(verb, wanted)  # before the rest: it takes the drivers, channels and axes to be those that run
        prepared = revise(self._prepared, configuration, source)
        back = source.data == self._file.data  # it is what the file says, and is called by the file's hash again
        return replace(prepared, source=self._file) if back else prepared, wanted

    def _refuse(self, verb: str, wanted: Mapping[KeyPath, str]) -> None:
        """Raise CheckFailed where the present state does not allow the verb, or one of the changes; it names each."""
        state = self._controller.state
        if verb in _WHILE_TRACKING and state != STATE_NAMES[TRACKING]:
            raise CheckFailed(f"{_words(verb)} refused: the state is {state}; {_WHILE_TRACKING[verb]} while TRACKING")
        allowed = (DISARM, WEAKENS) if state in _AT_REST else ()
        if refused := [f"{key_text(path)} {what}" for path, what in wanted.items() if what not in allowed]:
            why = "a candidate takes live values only" if verb == "candidate_set" else f"the state is {state}"
            raise CheckFailed(f"nothing was changed, {why}: {'; '.join(refused)}")

    async def _swap(self, verb: str, source: Source) -> Swap:
        """Put `source` in force; what that changed, and what is told of it that was not told before."""
        old = self._prepared
        new, version = await self._transact(verb, source)
        warnings = await asyncio.to_thread(new.warnings_since, old)
        return Swap(version=version, changed=changes(old.configuration, new.configuration), warnings=warnings)

    async def save(self, *, force: bool) -> Saved:
        """Write the running values into the file, but for where a jog has sent the axes: that is no tuning.

        Raises CheckFailed where it was changed on disk and not `force`, PermissionDenied where it can't be written.
        """
        async with self._changing():
            on_disk = await asyncio.to_thread(Source.read, self._file.path)
            if on_disk.hash != self._file.hash and not force:
                raise CheckFailed(
                    f"{on_disk.path} was changed on disk since it was loaded: see `micromanip diff`; `reload` takes "
                    "over its values, `save --force` writes the running ones into it"
                )
            running = self._prepared.source.data
            saved = await asyncio.to_thread(write_into, on_disk, kept := _kept(running, on_disk.data))
            if kept == running:
                self._keep(saved)
            else:  # the targets hold on, also through what is set next
                self._file = saved
            written = changes(validate_document(on_disk), validate_document(saved))
            return Saved(file=str(saved.path), sha256=saved.hash, changed=written)

    async def candidate_promote(self) -> tuple[replies.Candidate, list[Change]]:
        """Put the candidate in force, on trial; CheckFailed where there is none, or nothing is tracked."""
        async with self._changing():
            self._candidate_for(
                "candidate_promote", (SHADOWING,), "`micromanip candidate set KEY=VALUE` offers a candidate"
            )
            self._refuse("candidate_promote", {})
            old = self._prepared.configuration
            await self._controller.command(PROMOTE)
            return self._stepped(SHADOWING, old)

    async def candidate_discard(self) -> tuple[replies.Candidate, list[Change]]:
        """Let the candidate go, or take it back where it is on trial; CheckFailed where there is neither."""
        async with self._changing():
            candidate = self._candidate_for("candidate_discard", (SHADOWING, ON_TRIAL), "nothing to discard")
            old = self._prepared.configuration
            before, candidate.discarded = candidate.standing, True
            try:
                await self._controller.command(WITHDRAW)
            except CheckFailed:
                candidate.discarded = False  # the loop was quicker, and has a reason of its own
                raise
            if candidate.standing == SHADOWING:
                self._candidate = None
            return self._stepped(before, old)

    def _candidate_for(self, verb: str, standings: tuple[int, ...], hint: str) -> Candidate:
        """The candidate, which must have one of these standings; else CheckFailed."""
        candidate = self._candidate
        if candidate is None or candidate.standing not in standings:
            there = f"the last one is {SHADOW_NAMES[candidate.standing]}" if candidate else "there is none"
            raise CheckFailed(f"{_words(verb)} refused: {there}; {hint}")
        return candidate

    def _stepped(self, before: int, old: Configuration) -> tuple[replies.Candidate, list[Change]]:
        """The candidate after a command, and what that has changed."""
        self._notice()
        shadow = report(self._candidate, self._controller.status)
        moved = Change(key="candidate", old=SHADOW_NAMES[before], new=shadow["standing"])
        return shadow, [moved, *changes(old, self._prepared.configuration)]

    def candidate_show(self) -> replies.Candidate:
        """Where the candidate stands, with its figures."""
        self.notice()
        return report(self._candidate, self._controller.status)

    def _refuse_on_trial(self) -> None:
        """Raise CheckFailed where the tuning in force may still be taken back."""
        if self._candidate is not None and self._candidate.standing == ON_TRIAL:
            raise CheckFailed(
                f"nothing was changed: the promoted tuning, parameter version {self._candidate.version}, is on trial; "
                "wait for its end (`micromanip candidate show` shows it), or `micromanip candidate discard`"
            )

    def _drop_candidate(self) -> None:
        candidate, self._candidate = self._candidate, None
        if candidate is not None and candidate.standing == SHADOWING:
            message = (
                f"WARNING: the candidate, parameter version {candidate.version}, is dropped: "
                "another tuning came into force"
            )
            self._happened(Outcome("drop", message, [step(SHADOWING, NO_SHADOW), *candidate.changed]))

    @contextlib.asynccontextmanager
    async def _changing(self) -> AsyncIterator[None]:
        """The only one to change anything, on the newest knowledge of the loop."""
        async with self._one_at_a_time:
            self._notice()
            self.injecting.require_none()
            self.moving.require_none()
            yield

    def notice(self) -> None:
        """Follow what the loop has decided; whoever changes something just now does so by itself."""
        if not self._one_at_a_time.locked():
            self._notice()

    def _notice(self) -> None:
        candidate, standing = self._candidate, int(self._controller.status["words"][w.SHADOW])
        if candidate is None or candidate.standing == standing or standing in (NO_SHADOW, SHADOWING):
            return
        if candidate.standing == SHADOWING:
            candidate.former = self._prepared
            self._put_in_force(candidate.prepared)
        candidate.standing = standing
        if standing == CONFIRMED:
            message = f"the promoted tuning, parameter version {candidate.version}, is confirmed"
            self._happened(Outcome("confirm", message, [step(ON_TRIAL, CONFIRMED)]))
        elif standing == TAKEN_BACK:
            self._take_back(candidate)

    def _take_back(self, candidate: Candidate) -> None:
        assert candidate.former is not None
        self._put_in_force(candidate.former)
        if candidate.discarded:
            candidate.reason = "it was discarded"
            return
        axes = list(self._prepared.configuration.axes)
        taken_back = why_taken_back(self._controller.status, self._controller.state, axes)
        candidate.reason = str(taken_back)
        back = [Change(key=c["key"], old=c["new"], new=c["old"]) for c in candidate.changed]
        why = Change(key="candidate", old=SHADOW_NAMES[ON_TRIAL], new=f"taken back: {candidate.reason}")
        self._happened(Outcome("take back", taken_back, [why, *back]))

    def _put_in_force(self, prepared: Prepared) -> None:
        self._controller.prepared = prepared
        self._announce(prepared.source)

    def _keep(self, source: Source) -> None:
        """`source` is the file now, and says what runs."""
        self._file = source
        self._put_in_force(replace(self._prepared, source=source))


def _words(verb: str) -> str:
    """A verb as its command is typed."""
    return verb.replace("_", " ")


def _kept(running: Any, on_disk: Any) -> Any:
    """What of `running` goes into the file: with the jog's targets that it has."""
    reference, before = running["reference"], on_disk["reference"]
    if reference.get("source") != "jog":
        return running
    own = {key: value for key, value in reference.items() if key != _TARGETS}
    if before.get("source") == "jog" and _TARGETS in before:
        own[_TARGETS] = before[_TARGETS]
    return {**running, "reference": own}
