"""The configuration file: every key, its type, its range and what it means.

``docs/configuration.md`` is generated from here. Sections that need more than one rule have a file
of their own: ``hysteresis.py``, ``axis.py``, ``reference.py``.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from micromanip.quantities import (
    Distance,
    Microseconds,
    MicrosecondsOrZero,
    Milliseconds,
    RampSeconds,
    RangeUm,
    RangeV,
    Seconds,
    SecondsOrZero,
    Speed,
    Volts,
    VoltsAboveZero,
)
from micromanip.rt.records import MAX_AXES, MAX_DRIVERS, MAX_OUTPUTS, MAX_SIGNALS

from .axis import Axis
from .base import Flag, Settings
from .faults import Faults
from .frame import Frame
from .key import AtRest, LargerIsWeaker, Live, NewStart, WiderIsWeaker
from .learning import Learning
from .reference import Reference, Tracker


class Loop(Settings):
    """The fixed-rate loop process."""

    rate_hz: int = Field(default=10_000, strict=True, ge=100, le=20_000, description="Cycles per second.")
    cpu: int | None = Field(
        default=None, strict=True, ge=0, le=65_535, description="CPU the loop is pinned to; null: any."
    )
    priority: int = Field(default=80, strict=True, ge=1, le=98, description="SCHED_FIFO priority.")
    spin_us: MicrosecondsOrZero = Field(
        default=60.0, description="The loop sleeps until this long before a deadline, then spins."
    )
    limits: Literal["hardware", "simulation"] = Field(
        description="Set of fault limits; simulation is wide, since a virtual machine stalls for tens of ms."
    )

    @property
    def period_ns(self) -> int:
        """Period of the loop."""
        return round(1e9 / self.rate_hz)


class Control(Settings):
    """The control socket: who may command the running controller and who may observe it."""

    operate_group: str | None = Field(
        default=None,
        min_length=1,
        description="Group with full rights, beside root and the controller's user; null: the host's own group.",
    )
    observe_group: str | None = Field(
        default=None,
        min_length=1,
        description="Group with read access only (status, get, diff, log, candidate show); null: none.",
    )


SWEEP_TURNS, _SWEEP_HZ = 5.0, 20.0
"""A flexure with a spindle has its first resonance near 60 Hz; at 50 Hz the sweep threw the stage from end to end."""


class Start(Settings):
    """Soft start and stop, and the checks on the way."""

    enable_s: SecondsOrZero = Field(default=0.1, description="Time for a switched amplifier to come on.")
    check_s: Seconds | None = Field(
        default=0.2,
        description="Duration of the polarity and scale check before the loops close for the first time after a "
        "start, for each axis' gauge and stage in turn. null: no check; simulation only.",
    )
    check_V: VoltsAboveZero = Field(default=5.0, description="Voltage step of the check.")
    check_um: Distance = Field(default=2.0, description="Set-point step of the check.")
    check_factor: Annotated[float, Field(strict=True, gt=1, le=1_000)] = Field(
        default=3.0, description="Largest factor between the measured and the expected response."
    )
    lift_s: RampSeconds = Field(
        default=0.5,
        description="Time from the park voltage to the working point; an axis begins 0.3 of it after the one before.",
    )
    sweep_s: SecondsOrZero = Field(
        default=1.0, description="Duration of the decaying sweep that erases the hysteresis memory; 0: no sweep."
    )
    settle_s: SecondsOrZero = Field(default=0.2, description="Time at the working point for the estimators to settle.")
    authority_s: RampSeconds = Field(default=0.5, description="Fade-in time of the correction.")
    ramp_s: RampSeconds = Field(default=0.5, description="Time from any voltage to the park voltage.")

    @model_validator(mode="after")
    def _sweep_below_resonance(self) -> Self:
        if 0.0 < self.sweep_s < SWEEP_TURNS / _SWEEP_HZ:
            raise ValueError(
                f"sweep_s: {SWEEP_TURNS:g} turns in {self.sweep_s:g} s, {SWEEP_TURNS / self.sweep_s:.3g} Hz, would "
                f"swing the stage on its flexure; at most {_SWEEP_HZ:g} Hz: {SWEEP_TURNS / _SWEEP_HZ:g} or more, or 0 "
                "for no sweep"
            )
        return self


class Driver(Settings):
    """A driver, found by its entry point; the driver checks its other keys."""

    model_config = ConfigDict(extra="allow", frozen=True)

    driver: str = Field(description="Entry point of the driver, see docs/write-a-driver.md.")
    without_watchdog: Flag = Field(
        default=False, description="Accept hardware without a watchdog that makes it safe when the loop is dead."
    )

    @property
    def options(self) -> dict[str, Any]:
        """The driver's own keys."""
        return dict(self.model_extra or {})


class Simulation(Settings):
    """The plant behind the devices that `micromanip device simulate` plays: `driver`, and the keys of that driver."""

    model_config = ConfigDict(extra="allow", frozen=True)

    driver: str = Field(default="simulated", description="Entry point of the simulated driver that is the plant.")

    @property
    def options(self) -> dict[str, Any]:
        """The driver's own keys."""
        return dict(self.model_extra or {})


ARMS_WITHIN_S = 30.0
"""So long `arm_on_start` waits for the first samples of a device that boots more slowly than the controller."""
PLAUSIBLE_UM = (-1000.0, 1000.0)
"""Strain and stage samples outside count as invalid where a signal has no range of its own."""


class Signal(Settings):
    """An input of the loop."""

    driver: str = Field(description="Driver that reads it.")
    channel: str | None = Field(
        default=None, description="Name of the channel in the driver; null: the signal's own name."
    )
    max_age_us: LargerIsWeaker[Live[Microseconds | None]] = Field(
        default=300.0,
        description="Largest age; an older sample is invalid. null: no limit. Not given: three samples' time and their "
        "way, 300 at 10 kHz.",
    )
    range_um: WiderIsWeaker[Live[RangeUm | None]] = Field(
        default=None, description="Valid range of strain and stage samples; null: +-1000 um."
    )


class Output(Settings):
    """An output of the loop: a piezo voltage."""

    driver: str = Field(description="Driver that writes it.")
    channel: str | None = Field(
        default=None, description="Name of the channel in the driver; null: the output's own name."
    )
    range_V: AtRest[RangeV] = Field(description="Hard limits of the voltage.")
    slew_V_per_ms: AtRest[Speed] = Field(
        description="Hard limit of the voltage's slew rate: at most the amplifier's current over the stack's "
        "capacitance."
    )
    # not AtRest: an output at rest would move to another voltage without being armed
    park_V: Volts = Field(default=0.0, description="Voltage at rest and after a fault.")

    @model_validator(mode="after")
    def _park_is_inside(self) -> Self:
        low, high = self.range_V
        if not low <= self.park_V <= high:
            raise ValueError(f"park_V {self.park_V:g} V is outside range_V {low:g}..{high:g} V")
        return self


class Trial(Settings):
    """A promoted candidate tuning is on trial; it is reverted if it is worse than the previous one."""

    trial_s: Seconds = Field(default=5.0, description="Duration of the trial.")
    error_factor: Annotated[float, Field(strict=True, ge=1, le=1_000_000)] = Field(
        default=2.0,
        description="Largest ratio of the rms error to that of the last second before; 0.1 um more are allowed always.",
    )


class Switch(Settings):
    """A digital output of the loop."""

    driver: str = Field(description="Driver that writes it.")
    channel: str | None = Field(
        default=None, description="Name of the channel in the driver; null: the switch's own name."
    )


class Heartbeat(Switch):
    """A digital output that toggles while the loop turns: for a watchdog on the amplifier's side."""

    period_ms: Milliseconds = Field(default=20.0, description="Period, on and off.")


class Switches(Settings):
    """Digital outputs; all are optional."""

    amplifier_enable: Switch | None = Field(default=None, description="1 while the amplifier should be on.")
    amplifier_reset: Switch | None = Field(
        default=None,
        description="1 for 0.2 s after `reset`, never otherwise: the amplifier clears its fault. `reset` is "
        "then accepted in READY too.",
    )
    feed_hold: Switch | None = Field(
        default=None, description="1 while the machine should not feed: during a hold, and from a fault until reset."
    )
    heartbeat: Heartbeat | None = Field(default=None, description="Toggles while the loop runs.")


class Configuration(Settings):
    """The whole file."""

    schema_version: NewStart[Literal[2]] = Field(description="Version of the schema.")
    loop: NewStart[Loop]
    start: AtRest[Start] = Start()
    drivers: NewStart[dict[str, Driver]] = Field(
        min_length=1, max_length=MAX_DRIVERS, description="Buses and cards, or the simulated cell."
    )
    signals: NewStart[dict[str, Signal]] = Field(
        max_length=MAX_SIGNALS,
        description="Names: strain_<axis>, stage_<axis> (capacitive), deviation_<axis> or, with reference.frame, "
        "tracker_<name>; in a simulation true_strain_<axis>, true_stage_<axis>, path_error_<axis>, "
        "uncompensated_<axis>. Digital, 1 is good: enable, interlock, amplifier_ok_<axis>, "
        "temperature_ok_<axis>; retracted (1: the tool is out of the cut). For learning: part and tool "
        "(0, or the number of the present one), temperature (of the cell, degC).",
    )
    outputs: NewStart[dict[str, Output]] = Field(max_length=MAX_OUTPUTS, description="Names: voltage_<axis>.")
    switches: NewStart[Switches] = Switches()
    faults: LargerIsWeaker[Live[Faults]] = Faults()
    shadow: Live[Trial] = Trial()
    reference: AtRest[Reference] = Field(description="Source of the axes' set-points.")
    axes: NewStart[dict[str, Axis]] = Field(
        min_length=1, max_length=MAX_AXES, description="The axes of the manipulator."
    )
    control: NewStart[Control] = Control()
    learning: NewStart[Learning | None] = Field(
        default=None, description="Learn the repeating path error from part to part and play its correction; null: off."
    )
    arm_on_start: NewStart[Flag] = Field(
        default=False,
        description=f"Arm once when READY, or within {ARMS_WITHIN_S:g} s of it as soon as every sensor is valid; "
        "simulated drivers only.",
    )
    simulation: NewStart[Simulation | None] = Field(
        default=None,
        description="Plant behind the devices of `micromanip device simulate`: `driver` and that driver's keys. `run` "
        "does not use it.",
    )

    @property
    def frame(self) -> Frame | None:
        """The tracker's frame, where there is one."""
        return self.reference.frame if isinstance(self.reference, Tracker) else None
