"""What verbs of the control socket but `status` answer: plain JSON types, the same for the host and its clients."""

from __future__ import annotations

from typing import Any, TypedDict


class Change(TypedDict):
    """One value that was changed, or was asked to be."""

    key: str
    old: Any
    new: Any


class Computed(TypedDict, total=False):
    """From what a value was `computed` that the file says nothing of; empty of every other."""

    computed: str


class Parameter(Computed):
    """A running value; `change` says what changing it takes: live, needs disarm, needs restart."""

    key: str
    value: Any
    change: str


class Swap(TypedDict):
    """Outcome of `set` and `reload`: the parameter version in force, what changed, what to think of."""

    version: int
    changed: list[Change]
    warnings: list[str]


class Difference(TypedDict):
    """A key whose value in the file is not the running one; null also stands for "not there"."""

    key: str
    file: Any
    running: Any
    change: str


class Differences(TypedDict):
    """Outcome of `diff`; `changed_on_disk`: somebody edited the file since the controller read it."""

    file: str
    changed_on_disk: bool
    differences: list[Difference]


class Saved(TypedDict):
    """Outcome of `save`."""

    file: str
    sha256: str
    changed: list[Change]


class Jogged(TypedDict):
    """Outcome of `jog`: where the axis is on its way to."""

    axis: str
    target_um: float


class Injected(TypedDict):
    """An injection that has begun: its number, how long it takes, and what the response is to be judged by.

    `configuration` is what runs; `path` says in cycles what sensors and output of the axis take; `simulated`: all of
    its drivers are.
    """

    number: int
    seconds: float
    configuration: dict[str, Any]
    path: dict[str, int]
    simulated: bool


class Response(TypedDict):
    """Where an injection stands; once `done`, spectra at its lines: input and output, [re, im] a period and line."""

    number: int
    done: bool
    progress: float
    frequency_Hz: list[float]
    input: list[list[list[float]]]
    output: list[list[list[float]]]


class Moved(TypedDict):
    """Where a move stands: its number, the cycle at which it began, how far the axis is from there, um."""

    number: int
    done: bool
    progress: float
    seconds: float
    begun_cycle: int | None
    offset_um: float


class _AuditEntry(TypedDict):
    time: str
    user: str
    uid: int | None
    pid: int | None
    verb: str
    accepted: bool
    reason: str | None
    changes: list[Change]
    missing_before: int


class AuditEntry(_AuditEntry, total=False):
    """A line of the audit trail; `missing_before` counts entries that could not be written just before it.

    `repeated`, where it is there, counts refusals like this one, or of that user, since the last that was written down.
    """

    repeated: int


class Audit(TypedDict):
    """Outcome of `log`: the last entries, oldest first; `unwritten` of this run are on no disk."""

    file: str
    unwritten: int
    entries: list[AuditEntry]


class Marked(TypedDict):
    """Outcome of `recording_mark`: the cycle (newest when it was asked for) and the recording that has it."""

    file: str
    cycle: int
    text: str


class Telemetry(TypedDict):
    """Outcome of `telemetry`: what is in the memory whose descriptors come with it.

    It is the loop's status, its ring, and the parameters of the host.

    `range_V` is the lowest and highest voltage of each axis; the sizes and `columns` say how it is laid out.
    """

    axes: list[str]
    drivers: list[str]
    range_V: dict[str, list[float]]
    period_ns: int
    status_bytes: int
    row_bytes: int
    control_bytes: int
    columns: list[str]


class RunningConfiguration(TypedDict):
    """Outcome of `configuration`: what runs, as a text of YAML, and the hash that names it in recordings."""

    text: str
    sha256: str


class TuningFigures(TypedDict):
    """How well a tuning does, rms over about the last second.

    `innovation_um`: how far its model is off one period ahead, None where the axis has no such model; `feedback_V`:
    what the PID has to add to the feedforward. None also where the figure has grown beyond all bounds.
    """

    innovation_um: float | None
    feedback_V: float | None


class Comparison(TypedDict):
    """One axis' figures under the tuning in force and, were it in force, under the candidate; smaller is better."""

    active: TuningFigures
    candidate: TuningFigures


class TrialError(TypedDict):
    """Error (rms) of an axis before the promotion and since; beyond the limit the promotion is taken back."""

    before_um: float | None
    now_um: float | None
    limit_um: float | None


class Candidate(TypedDict):
    """Where the candidate stands: none, shadowing, on trial, confirmed, taken back.

    `comparison` is there while it shadows, `trial` once it was promoted, both by axis; `reason` says why it was taken
    back, `passed_s` and `trial_s` how much of the trial is over.
    """

    standing: str
    version: int | None
    changed: list[Change]
    comparison: dict[str, Comparison]
    trial: dict[str, TrialError]
    passed_s: float | None
    trial_s: float | None
    reason: str | None
