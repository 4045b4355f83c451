"""What the verbs answer: values, configurations beside each other, and a candidate tuning with its figures.

The loop gathers the figures of the tuning in force, of the candidate beside it, and of a trial.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from micromanip import replies
from micromanip.faults import BY_NAME, FaultReport, raised
from micromanip.replies import Change, Comparison, Computed, Difference, Parameter, TrialError, TuningFigures
from micromanip.rt.states import NO_SHADOW, ROLLED_BACK, SHADOW_NAMES, SHADOWING, STAGE, STATE_NAMES, TRACKING, VOLTAGE
from micromanip.settings.change import ABSENT, changed, needed, values
from micromanip.settings.check import Prepared
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.keys import selected
from micromanip.settings.text.place import Path as KeyPath
from micromanip.settings.text.source import key_text
from micromanip.settings.wiring.timing import age_is_computed, signal_timing


def parameters(running: Prepared, keys: Sequence[str]) -> list[Parameter]:
    """Values of `keys`, of all below where one is a section, of all without; UsageError where one is unknown."""
    leaves = values(running.configuration)
    paths = selected(leaves, running.configuration.model_dump(mode="json"), keys)
    return [
        Parameter(key=key_text(path), value=leaves[path], change=needed(path), **_computed(running, path))
        for path in paths
    ]


def _computed(running: Prepared, path: KeyPath) -> Computed:
    """From what the value at `path` was computed, where the file says nothing of it."""
    if not age_is_computed(running.source, path):
        return {}
    channel = signal_timing(running.configuration, running.wiring, str(path[1]))
    return {"computed": f"three samples at {channel.rate_hz:g} Hz and {1e6 * channel.latency_s:.0f} us on their way"}


def changes(old: Configuration, new: Configuration) -> list[Change]:
    """What is another value in `new`."""
    return [
        Change(key=key_text(path), old=_shown(before), new=_shown(after))
        for path, (before, after) in changed(old, new).items()
    ]


def differences(file: Configuration, running: Configuration) -> list[Difference]:
    """What runs with another value than the file has."""
    return [
        Difference(key=key_text(path), file=_shown(on_disk), running=_shown(runs), change=needed(path))
        for path, (on_disk, runs) in changed(file, running).items()
    ]


def _shown(value: Any) -> Any:
    return None if value is ABSENT else value


def report(candidate: Candidate | None, status: Any) -> replies.Candidate:
    """Where the candidate stands, with its figures."""
    if candidate is None:
        return replies.Candidate(
            standing=SHADOW_NAMES[NO_SHADOW],
            version=None,
            changed=[],
            comparison={},
            trial={},
            passed_s=None,
            trial_s=None,
            reason=None,
        )
    cell, axes = candidate.prepared.parameters[0], list(candidate.prepared.configuration.axes)
    period_s, promoted = int(cell["period_ns"]) * 1e-9, candidate.standing != SHADOWING
    passed_cycles = max(0, int(status["state"][0]["trial_cycles"]))
    return replies.Candidate(
        standing=SHADOW_NAMES[candidate.standing],
        version=candidate.version,
        changed=candidate.changed,
        comparison={} if promoted else _comparison(status, cell, axes),
        trial=_trial(status, cell, axes) if promoted else {},
        passed_s=passed_cycles * period_s if promoted else None,
        trial_s=int(cell["trial_cycles"]) * period_s,
        reason=candidate.reason,
    )


def _comparison(status: Any, cell: Any, axes: list[str]) -> dict[str, Comparison]:
    """Figures of both tunings by axis, of those that are controlled; `cell` are the candidate's parameters."""
    active, candidate = status["state"][0]["figures"], status["shadow"][0]["figures"]
    return {
        name: Comparison(active=_figures(active[i], mode), candidate=_figures(candidate[i], mode))
        for i, name in enumerate(axes)
        if (mode := int(cell["axis"][i]["mode"])) != VOLTAGE
    }


def _trial(status: Any, cell: Any, axes: list[str]) -> dict[str, TrialError]:
    """Errors on trial by axis, of those that are controlled."""
    state = status["state"][0]
    found = {}
    for i, name in enumerate(axes):
        if cell["axis"][i]["mode"] != VOLTAGE:
            before = math.sqrt(state["trial_before"][i])
            limit = float(cell["trial_factor"]) * before + float(cell["trial_floor"])
            found[name] = TrialError(
                before_um=_rounded(before), now_um=_root(state["trial_now"][i]), limit_um=_rounded(limit)
            )
    return found


def _figures(figures: Any, mode: int) -> TuningFigures:
    innovation_um = _root(figures["innovation"]) if mode == STAGE else None
    return TuningFigures(innovation_um=innovation_um, feedback_V=_root(figures["feedback"]))


def _root(square: Any) -> float | None:
    return _rounded(math.sqrt(square))


def _rounded(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


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
