"""A candidate tuning as the host knows it: what was offered, where it stands, and why the loop took it back."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from micromanip.faults import BY_NAME, FaultReport, raised
from micromanip.replies import Change
from micromanip.rt.states import ROLLED_BACK, SHADOW_NAMES, SHADOWING, STATE_NAMES, TRACKING
from micromanip.settings.check import Prepared


@dataclass
class Candidate:
    """A tuning that was offered; `former` is what it replaced, once it was promoted."""

    version: int
    prepared: Prepared
    changed: list[Change]
    standing: int = SHADOWING
    former: Prepared | None = None
    reason: str | None = None
    discarded: bool = False


@dataclass(frozen=True)
class Outcome:
    """What happened to a candidate without anybody asking for it: for people, and for the audit trail."""

    verb: str
    told: str | FaultReport
    changed: list[Change] = field(default_factory=list)


def step(old: int, new: int) -> Change:
    """From one standing to another."""
    return Change(key="candidate", old=SHADOW_NAMES[old], new=SHADOW_NAMES[new])


def why_taken_back(status: Any, state: str, axes: list[str]) -> FaultReport:
    """The newest warning of the loop that tells of it."""
    cell, kind = status["state"][0], BY_NAME["ROLLED_BACK"]
    ring = cell["event"]
    newest = [ring[k % len(ring)] for k in range(int(cell["events"]) - 1, -1, -1)[: len(ring)]]
    event = next((event for event in newest if event["code"] == ROLLED_BACK), None)
    if event is None or event["axis"] < 0:  # no axis is to blame
        why = (
            "too many deadlines were missed to judge it"
            if state == STATE_NAMES[TRACKING]
            else f"the cell no longer tracks, its state is {state}"
        )
        return FaultReport(kind, what=f"the promoted tuning was reverted: {why}", explained=False)
    report = raised(event, axes)
    assert report is not None
    if report.value <= report.limit:
        return replace(report, what="the promoted tuning was reverted: it swings")
    return report
