"""Section ``faults``: what is watched, its limits, and what follows; two sets of defaults.

The set `hardware` is what `loop.limits: hardware` means; `simulation` is wide, because a virtual machine stalls for
tens of milliseconds and a stalled loop moves late. A key that the file gives replaces the set's; ``null`` means no
limit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from micromanip.quantities import (
    Count,
    Distance,
    DistanceOrZero,
    Milliseconds,
    MillisecondsOrZero,
    Percent,
    Positive,
    RangeHz,
    Seconds,
    SecondsOrZero,
    Speed,
)

from .base import Settings
from .key import NarrowerIsWeaker, NeverWeaker, SmallerIsWeaker

REACTIONS = ("warn", "hold", "ramp", "off")
"""The mildest first."""
Reaction = Literal["warn", "hold", "ramp", "off"]
_SET = "simulation"
_REACTION = "Reaction to the fault."


def _default(hardware: float, description: str, *, simulation: float | None) -> Any:
    """A limit that is another one in the set `simulation`."""
    return Field(default=hardware, description=description, json_schema_extra={_SET: simulation})


class StrainInvalid(Settings):
    """Strain gauge: not finite, out of range, jumped, stale, or stuck."""

    samples: Count | None = Field(default=3, description="Unusable samples in a row.")
    identical: Count | None = Field(default=20, description="Identical readings in a row: the gauge is stuck.")
    rate_um_per_ms: Speed | None = _default(
        100.0, "Fastest plausible change; a faster reading is unusable.", simulation=1000.0
    )
    coast_ms: MillisecondsOrZero = Field(default=5.0, description="Time on the feedforward alone before the reaction.")
    reaction: Reaction = Field(default="ramp", description=_REACTION)


class StageInvalid(Settings):
    """The same faults of the capacitive sensor."""

    samples: Count | None = Field(default=3, description="Unusable samples in a row.")
    identical: Count | None = Field(default=20, description="Identical readings in a row: the sensor is stuck.")
    rate_um_per_ms: Speed | None = Field(
        default=1000.0, description="Fastest plausible change; a faster reading is unusable."
    )
    degraded_s: SecondsOrZero = Field(default=1.0, description="Time on the model's prediction before the reaction.")
    reaction: Reaction = Field(default="ramp", description=_REACTION)


class Disagreement(Settings):
    """Strain gauge and capacitive sensor disagree: the Kalman filter's innovation is too large."""

    ratio: Positive | None = _default(
        25.0,
        "Mean square innovation over the variance that the filter expects, beyond the process' share.",
        simulation=None,
    )
    time_ms: Milliseconds = Field(default=10.0, description="Averaging time.")
    drift_um: Distance | None = Field(
        default=100.0,
        description="Slow deviation of the stage from where the gauge says it is, the process' force included.",
    )
    process_um: DistanceOrZero = Field(
        default=60.0,
        description="Allowance for the process: the stage's deflection under its steady force without control (force "
        "over stiffness), plus half of that as an oscillation at outer.oscillation_Hz.",
    )
    process_ms: SmallerIsWeaker[Annotated[Milliseconds, Field(le=1000.0)]] = Field(
        default=20.0, description="Rise time of the process' force."
    )
    reaction: Reaction = Field(default="hold", description=_REACTION)


class FollowingError(Settings):
    """Stage minus reference (mode stage), or gauge minus set-point."""

    limit_um: Distance | None = _default(20.0, "Largest error.", simulation=400.0)
    time_ms: Milliseconds = _default(5.0, "Time until the reaction.", simulation=100.0)
    reaction: Reaction = Field(default="hold", description=_REACTION)


class Saturation(Settings):
    """The voltage is at an end of its range."""

    warn_ms: Milliseconds | None = Field(default=50.0, description="Time until the warning.")
    time_ms: Milliseconds | None = Field(default=500.0, description="Time until the reaction.")
    reaction: Reaction = Field(default="hold", description=_REACTION)


class Oscillation(Settings):
    """The inner loop oscillates: rms of its error in a band."""

    limit_um: Distance | None = _default(1.0, "Largest rms in the band.", simulation=20.0)
    band_Hz: NarrowerIsWeaker[RangeHz] = Field(
        default=(300.0, 1500.0), description="Band in which a loop would oscillate."
    )
    time_ms: Milliseconds = _default(
        20.0, "Time until the fallback gains act, then until the reaction.", simulation=200.0
    )
    fallback: Annotated[float, Field(strict=True, ge=1e-6, lt=1)] = Field(
        default=0.4, description="Gain of the PID during fallback, as a share of its own."
    )
    reaction: Reaction = Field(default="ramp", description=_REACTION)


class ReferenceLost(Settings):
    """No usable sample of the reference signal."""

    stale_periods: Positive | None = _default(2.0, "Periods of the signal until the warning.", simulation=20.0)
    time_ms: Milliseconds | None = _default(20.0, "Time until the reaction.", simulation=500.0)
    identical: Count | None = Field(default=200, description="Identical readings in a row until the warning.")
    decay_ms: NeverWeaker[Milliseconds] = Field(
        default=200.0, description="Time in which the hold returns to the working point."
    )
    reaction: Reaction = Field(default="hold", description=_REACTION)


class Amplifier(Settings):
    """The signal amplifier_ok is not 1."""

    reaction: Reaction = Field(default="off", description=_REACTION)


class OverTemperature(Settings):
    """The signal temperature_ok is not 1."""

    derate_percent: Percent = Field(default=50.0, description="Share of the correction while the amplifier is hot.")
    time_s: SecondsOrZero = Field(default=2.0, description="Time until the reaction.")
    reaction: Reaction = Field(default="ramp", description=_REACTION)


class AxisFaults(Settings):
    """Faults of one axis."""

    strain: StrainInvalid = StrainInvalid()
    stage: StageInvalid = StageInvalid()
    disagreement: Disagreement = Disagreement()
    following_error: FollowingError = FollowingError()
    saturation: Saturation = Saturation()
    oscillation: Oscillation = Oscillation()
    reference: ReferenceLost = ReferenceLost()
    amplifier: Amplifier = Amplifier()
    over_temperature: OverTemperature = OverTemperature()


class Deadline(Settings):
    """The loop misses its deadlines."""

    in_a_row: Count | None = _default(3, "Missed deadlines in a row.", simulation=None)
    share_percent: Percent | None = _default(0.1, "Largest share of missed deadlines in one second.", simulation=None)
    reaction: Literal["hold", "ramp"] = Field(default="hold", description="Reaction to the fault.")


class Host(Settings):
    """The host process is silent."""

    silent_ms: Milliseconds = _default(100.0, "Longest silence.", simulation=3000.0)
    reaction: Literal["hold", "ramp"] = Field(default="hold", description="Reaction to the fault; then the loop ends.")


class DriverError(Settings):
    """A driver's exchange fails."""

    reaction: Literal["hold", "ramp", "off"] = Field(default="ramp", description="Reaction to the fault.")


class Link(Settings):
    """The link to a bus is lost: bus-off, broken cable, device without power, dead worker process."""

    silent_ms: Milliseconds = _default(
        20.0,
        "Longest silence of a worker process; longest duration of bus errors.",
        simulation=300.0,
    )
    loop_silent_ms: Milliseconds = _default(
        5.0, "Longest silence of the loop; then the worker ramps its outputs to park.", simulation=100.0
    )
    reaction: Literal["ramp", "off"] = Field(default="ramp", description="Reaction to the fault.")


class Enable(Settings):
    """The signal enable is not 1: emergency stop."""

    reaction: Literal["off"] = Field(
        default="off", description="Reaction to the fault; the hardware has already switched the amplifier off."
    )


class Interlock(Settings):
    """The signal interlock is not 1: a door, a guard."""

    reaction: Literal["hold", "ramp", "off"] = Field(default="ramp", description="Reaction to the fault.")


class Hold(Settings):
    """A hold after a fault."""

    timeout_s: Seconds = Field(
        default=1.0, description="The ramp begins when the signal retracted is 1, at the latest after this time."
    )


class Faults(Settings):
    """Faults of the whole cell. Each axis' own section `faults` takes its defaults from `axis`."""

    deadline: Deadline = Deadline()
    host: Host = Host()
    driver: DriverError = DriverError()
    link: Link = Link()
    enable: Enable = Enable()
    interlock: Interlock = Interlock()
    hold: Hold = Hold()
    axis: AxisFaults = AxisFaults()


def _of_simulation(section: type[BaseModel]) -> dict[str, Any]:
    """The defaults of the set `simulation` that are others, of a section and those in it."""
    found: dict[str, Any] = {}
    for name, field in section.model_fields.items():
        if isinstance(field.default, BaseModel):
            if below := _of_simulation(type(field.default)):
                found[name] = below
        elif isinstance(field.json_schema_extra, dict) and _SET in field.json_schema_extra:
            found[name] = field.json_schema_extra[_SET]
    return found


SIMULATION = _of_simulation(Faults)
"""Where the set `simulation` differs from `hardware`, which is the models' defaults."""

LOOP_STUCK_S = {"hardware": 0.3, "simulation": 2.0}
"""A loop that lives but has run no cycle for so long is ended by the host."""
SWINGS, SWING_S = 8, 2.0
"""From one end of a range to the other so often in this time is a limit cycle, whatever the limits."""


def merged(base: Mapping[str, Any], own: Any) -> Any:
    """`own` over `base`, section by section; what is not a section is left for the validation to find."""
    if own is None:
        return dict(base)
    if not isinstance(own, Mapping):
        return own
    result = dict(own)
    for key, value in base.items():
        if key not in own:
            result[key] = value
        elif isinstance(value, Mapping):
            result[key] = merged(value, own[key]) if own[key] is not None else None
    return result


def with_limits(document: Any) -> Any:
    """The configuration's document with every axis' limits spelt out: its own over the cell's over the chosen set."""
    if not isinstance(document, Mapping):
        return document
    loop = document.get("loop")
    simulated = isinstance(loop, Mapping) and loop.get("limits") == "simulation"
    faults = merged(SIMULATION if simulated else {}, document.get("faults"))
    result = {**document, "faults": faults}
    common = faults.get("axis", {}) if isinstance(faults, Mapping) else {}
    axes = document.get("axes")
    if isinstance(axes, Mapping) and isinstance(common, Mapping):
        result["axes"] = {
            name: {**axis, "faults": merged(common, axis.get("faults"))} if isinstance(axis, Mapping) else axis
            for name, axis in axes.items()
        }
    return result
