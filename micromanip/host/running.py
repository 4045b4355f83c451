"""The configuration in force, the file that it came from, and the candidate that may take its place.

One change at a time. What the loop decides by itself, the end of a trial, is noticed here before anything else is
changed: the configuration in force is then the former one again.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from micromanip.errors import CheckFailed, ConfigError
from micromanip.faults import BY_NAME, FaultReport, raised
from micromanip.replies import Change
from micromanip.rt import mailbox as w
from micromanip.rt.states import (
    CONFIRMED,
    NO_SHADOW,
    ON_TRIAL,
    ROLLED_BACK,
    SHADOW_NAMES,
    SHADOWING,
    STATE_NAMES,
    TAKEN_BACK,
    TRACKING,
)
from micromanip.settings.change import LIVE, needs
from micromanip.settings.check import Prepared, revise, validate
from micromanip.settings.load import validate_document
from micromanip.settings.protection import weakened
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.place import Path as KeyPath
from micromanip.settings.text.source import Source
from micromanip.settings.wiring.places import driver_options

from .differences import changes


class Tunable(Protocol):
    """What runs: `micromanip.host.controller.Controller`."""

    prepared: Prepared
    status: Any

    @property
    def state(self) -> str:
        """Name of the cell's state."""

    async def adopt(self, prepared: Prepared, permit: Callable[[], None]) -> int:
        """Swap to `prepared` once `permit` has not raised, with no command in between; the version in force."""

    async def offer(self, parameters: Any) -> int:
        """Let a candidate compute beside what is in force; its version."""

    async def command(self, command: int) -> None:
        """Give a command and wait for its outcome; CheckFailed where it was refused."""


@dataclass
class Candidate:
    """A tuning that was offered; `former` is what it replaced, once it was promoted."""

    version: int
    prepared: Prepared
    document: Mapping[str, Any]
    changed: list[Change]
    standing: int = SHADOWING
    former: tuple[Prepared, Mapping[str, Any]] | None = None
    reason: str | None = None
    withdrawn: bool = False


@dataclass(frozen=True)
class Outcome:
    """What happened to a candidate without anybody asking for it: for people, and for the audit trail."""

    verb: str
    told: str | FaultReport
    changed: list[Change] = field(default_factory=list)


class Running:
    """What is in force in one controller."""

    def __init__(
        self, controller: Tunable, tell: Callable[[Source], None], happened: Callable[[Outcome], None]
    ) -> None:
        """`tell` hears of each configuration that has come into force, or has been written to the file."""
        self.controller, self._tell, self._happened = controller, tell, happened
        self.file = controller.prepared.source
        same = _configuration(self.file) == controller.prepared.configuration
        self.document: Mapping[str, Any] = (
            self.file.data if same else controller.prepared.configuration.model_dump(mode="json")
        )
        self.candidate: Candidate | None = None
        self._one_at_a_time = asyncio.Lock()

    @property
    def prepared(self) -> Prepared:
        """What is in force."""
        return self.controller.prepared

    @contextlib.asynccontextmanager
    async def changing(self) -> AsyncIterator[None]:
        """The only one to change anything, on the newest knowledge of the loop."""
        async with self._one_at_a_time:
            self._notice()
            yield

    def notice(self) -> None:
        """Follow what the loop has decided; whoever changes something just now does so by itself."""
        if not self._one_at_a_time.locked():
            self._notice()

    def _notice(self) -> None:
        candidate, standing = self.candidate, int(self.controller.status["words"][w.SHADOW])
        if candidate is None or candidate.standing == standing or standing in (NO_SHADOW, SHADOWING):
            return
        if candidate.standing == SHADOWING:
            candidate.former = (self.prepared, self.document)
            self._put_in_force(candidate.prepared, candidate.document)
        candidate.standing = standing
        if standing == CONFIRMED:
            message = f"the promoted tuning, parameter version {candidate.version}, is confirmed"
            self._happened(Outcome("confirm", message, [_step(ON_TRIAL, CONFIRMED)]))
        elif standing == TAKEN_BACK:
            self._take_back(candidate)

    def _take_back(self, candidate: Candidate) -> None:
        assert candidate.former is not None
        self._put_in_force(*candidate.former)
        if candidate.withdrawn:
            candidate.reason = "it was withdrawn"
            return
        report = self._why_taken_back()
        candidate.reason = str(report)
        back = [Change(key=c["key"], old=c["new"], new=c["old"]) for c in candidate.changed]
        why = Change(key="candidate", old=SHADOW_NAMES[ON_TRIAL], new=f"taken back: {candidate.reason}")
        self._happened(Outcome("take back", report, [why, *back]))

    def _why_taken_back(self) -> FaultReport:
        """The newest warning of the loop that tells of it."""
        state = self.controller.status["state"][0]
        ring, kind = state["event"], BY_NAME["ROLLED_BACK"]
        newest = [ring[k % len(ring)] for k in range(int(state["events"]) - 1, -1, -1)[: len(ring)]]
        event = next((event for event in newest if event["code"] == ROLLED_BACK), None)
        if event is None or event["axis"] < 0:  # no axis is to blame
            state_name = self.controller.state
            why = (
                "too many deadlines were missed to judge it"
                if state_name == STATE_NAMES[TRACKING]
                else f"the cell does not track any more, its state is {state_name}"
            )
            return FaultReport(kind, what=f"the promoted tuning was taken back: {why}", explained=False)
        report = raised(event, list(self.prepared.configuration.axes))
        assert report is not None
        if report.value <= report.limit:
            return replace(report, what="the promoted tuning was taken back: it swings")
        return report

    def _put_in_force(self, prepared: Prepared, document: Mapping[str, Any]) -> None:
        self.controller.prepared, self.document = prepared, document
        self._tell(prepared.source)

    async def swap(self, prepared: Prepared, permit: Callable[[], None]) -> int:
        """Put another configuration in force at one cycle boundary; a candidate that shadows is dropped."""
        version = await self.controller.adopt(prepared, permit)
        self._put_in_force(prepared, prepared.source.data)
        if self.candidate is not None and self.candidate.standing == SHADOWING:
            message = (
                f"WARNING: the candidate, parameter version {self.candidate.version}, is dropped: "
                "another tuning came into force"
            )
            self._happened(Outcome("drop", message, [_step(SHADOWING, NO_SHADOW), *self.candidate.changed]))
        self.candidate = None
        return version

    def keep(self, source: Source) -> None:
        """`source` is the file now, and says what runs."""
        self.file = source
        self._put_in_force(replace(self.prepared, source=source), source.data)

    def refuse_on_trial(self) -> None:
        """Raise CheckFailed where the tuning in force may still be taken back."""
        if self.candidate is not None and self.candidate.standing == ON_TRIAL:
            raise CheckFailed(
                f"nothing was changed: the promoted tuning, parameter version {self.candidate.version}, is on trial; "
                "wait for its end (`micromanip shadow` shows it), or `micromanip withdraw`"
            )

    async def revised(
        self, source: Source, refuse: Callable[[Mapping[KeyPath, str]], None]
    ) -> tuple[Prepared, dict[KeyPath, str]]:
        """`source` ready to run, and those of its changes that are more than live; `refuse` sees them at once."""
        return await asyncio.to_thread(self._revised, source, refuse)

    def _revised(
        self, source: Source, refuse: Callable[[Mapping[KeyPath, str]], None]
    ) -> tuple[Prepared, dict[KeyPath, str]]:
        running = self.prepared
        configuration = validate(source)
        for name, entry in configuration.drivers.items():
            driver_options(source, name, entry)
        wanted = weakened(running.configuration, configuration)
        wanted |= {path: what for path, what in needs(running.configuration, configuration).items() if what != LIVE}
        refuse(wanted)
        revised = revise(running, source)
        if source.data == self.file.data:  # back to what the file says
            revised = replace(revised, source=self.file)
        return revised, wanted

    def offered(self, version: int, prepared: Prepared, document: Mapping[str, Any]) -> None:
        """A candidate computes beside what is in force; it takes the place of the one before."""
        changed = changes(self.prepared.configuration, prepared.configuration)
        self.candidate = Candidate(version, prepared, document, changed)


def _step(old: int, new: int) -> Change:
    return Change(key="candidate", old=SHADOW_NAMES[old], new=SHADOW_NAMES[new])


def _configuration(source: Source) -> Configuration | None:
    try:
        return validate_document(source)
    except ConfigError:
        return None
