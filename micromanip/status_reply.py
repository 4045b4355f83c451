"""What `status` answers: the report of a run, in plain JSON types, the same for the host and its clients."""

from __future__ import annotations

from typing import Any, TypedDict


class Durations(TypedDict):
    """Percentiles and maximum of a time."""

    p50: int
    p99: int
    p99_9: int
    p99_99: int
    max: int


class PathError(TypedDict):
    """Figures of one axis since a second after tracking began; None where there are none.

    `uncompensated_rms` also where nothing deviates: neither a signal is followed nor does a simulation tell.
    """

    uncompensated_rms: float | None
    rms: float | None
    max: float | None


class Window(TypedDict):
    """Figures of a quantity over the last second or minute, in its own unit.

    `seconds` is how much of that has known values in it. `rms` and `peak` (largest magnitude) are about zero, what an
    error is judged by; `deviation_rms` and `deviation_peak` about the mean: how much a position or a voltage moved.
    """

    seconds: float
    mean: float
    min: float
    max: float
    rms: float
    peak: float
    deviation_rms: float
    deviation_peak: float


NO_SIGNAL = "no signal"
"""So begins why a quantity is unknown for as long as the cell is wired like this."""


class Value(TypedDict):
    """A quantity now and before; `latest` is None where it is not known or stale, and `unknown` then says why."""

    latest: float | None
    unknown: str | None
    second: Window | None
    minute: Window | None


class Swing(TypedDict):
    """A swing while the reference is held: frequency and amplitude."""

    Hz: float
    um: float


class AxisValues(TypedDict):
    """What an axis does: position of the stage, set-point of the actuator, its gauge, its voltage, the error.

    `headroom_V` is what the voltage has left to the nearer end of its range. `error_of` says what the error is of:
    path, at the spindle (the simulation's truth, else by the stage's sensor); gauge, set-point less gauge; None in
    open loop. `tooth_Hz` is where the outer loop has found the tooth's frequency, None where it does not follow it.
    `joints_Hz` is the same of each of the predictor's oscillations, in the order of the configuration. `untuned` is an
    axis that nobody has tuned yet; `less` what its commissioning did not reach, None where it did or never was. `swing`
    is that of its stage, or in mode strain its gauge, in the last second while its reference was held; None: noise.
    """

    position_um: Value
    setpoint_um: Value
    strain_um: Value
    voltage_V: Value
    headroom_V: Value
    error_um: Value
    error_of: str | None
    tooth_Hz: float | None
    joints_Hz: list[float | None]
    untuned: bool
    less: str | None
    swing: Swing | None


class SignalFigures(TypedDict):
    """Rate, age and losses of a signal.

    Of all that its device took since the first one that the loop saw, `samples` were used, `refused` were bad or not to
    be believed, `superseded` came together with a newer one or while the loop missed cycles, and `lost` never came.
    `late` are the samples that were older than the signal's ``max_age_us`` when they came, `stale_cycles` the cycles
    in which the newest one was: then it is not used. `stated_hz` is the rate that its driver states.
    """

    rate_hz: float
    stated_hz: float
    age_p50_us: int | None
    age_p99_9_us: int | None
    age_max_us: int | None
    lost: int
    superseded: int
    refused: int
    samples: int
    late: int
    stale_cycles: int


class Fault(TypedDict):
    """A latched fault: `name` as in ``micromanip.rt.states``, `driver` whose link was lost, `cycle` of its notice.

    `value` was measured and `limit` is what it was held against, in the fault's own unit; None where there is none.
    """

    code: str
    name: str
    axis: str | None
    driver: str | None
    value: float | None
    limit: float | None
    cycle: int | None
    seen: str
    likely_causes: list[str]
    next_step: str


class Trip(TypedDict):
    """A latched fault and its black box; `problem` says why it is not on disk."""

    code: str
    file: str | None
    complete: bool
    problem: str | None


class Recorded(TypedDict):
    """The recording of a run: `state` is starting, recording, complete or failed.

    `rows` are in the file, which has so many `bytes`; `dropped` were overwritten before they could be; `message` says
    why it failed.
    """

    file: str
    state: str
    rows: int
    dropped: int
    message: str | None
    bytes: int
    marks: int


class Link(TypedDict):
    """A bus: `link` is down, up or latched; `outputs` at rest, following, ramping to rest, or unknown; `given` what its
    device was given last, by the outputs' names (V, or 0 and 1), and so many seconds ago, None where nobody knows.

    `links` is how often the link came up, `starts` how often its worker process was started; `message` what is wrong
    with it; `counts` its counters.
    """

    link: str
    outputs: str
    given: dict[str, float | None]
    given_s_ago: float | None
    links: int
    starts: int
    message: str | None
    counts: dict[str, int]
    cpu_s: float


class AxisLearning(TypedDict):
    """Learning of an axis: the generation of its memory, None where it has none, and whether it may be played.

    `state` is idle, plays, finished, path left, broken off, withdrawn, part ended or other tool; `part` the number of
    the part that is being made; `apart_um` how far the reference was from the learned path when it was last
    looked at; `last` what became of the last part that was learned from.
    """

    generation: int | None
    may_play: bool
    state: str
    part: int | None
    apart_um: float
    last: dict[str, Any] | None


class LearningStatus(TypedDict):
    """Outcome of `learn_status`: `state` is starting, learning or off; `made` numbers the last whole part.

    `tool` and `temperature_C` are those of now, None where none is told.
    """

    state: str
    made: int
    folder: str
    axes: dict[str, AxisLearning]
    tool: int | None
    temperature_C: float | None


class Status(TypedDict):
    """Report of a run so far, as ``run --json`` ends with.

    `axes` is what each axis does now; `path_error_um` are figures since tracking began; `faults` are those that are
    latched, for people, `fault_reports` the same as data, the one that ends the run last;
    `candidate` says where a candidate tuning stands; `recording` is None where nothing is recorded, `learning` where
    nothing is learned.
    """

    state: str
    cycles: int
    overruns: int
    period_ns: int
    lateness_ns: Durations
    compute_ns: Durations
    path_error_um: dict[str, PathError]
    axes: dict[str, AxisValues]
    signals: dict[str, SignalFigures]
    slow_signals: list[str]
    faults: list[str]
    fault_reports: list[Fault]
    parameter_version: int
    candidate: str
    configuration: str
    configuration_sha256: str
    trips: list[Trip]
    links: dict[str, Link]
    recording: Recorded | None
    learning: LearningStatus | None
