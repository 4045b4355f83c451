"""The configuration file: every key, its type, its range and what it means.

``docs/configuration.md`` is generated from here. Sections that need more than one rule have a file
of their own: ``hysteresis.py``, ``axis.py``, ``reference.py``.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from micromanip.quantities import (
    Distance,
    DistanceOrZero,
    Microseconds,
    MicrosecondsOrZero,
    Milliseconds,
    Positive,
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

    rate_hz: int = Field(default=10_000, strict=True, ge=100, le=20_000, description="Cycles a second.")
    cpu: int | None = Field(
        default=None, strict=True, ge=0, le=65_535, description="CPU the loop is pinned to; null leaves it free."
    )
    priority: int = Field(default=80, strict=True, ge=1, le=98, description="SCHED_FIFO priority.")
    spin_us: MicrosecondsOrZero = Field(
        default=60.0, description="The loop sleeps to this long before a deadline and spins the rest."
    )
    limits: Literal["hardware", "simulation"] = Field(
        description="Which set of fault limits applies; simulation is wide: a virtual machine stalls for tens of ms."
    )

    @property
    def period_ns(self) -> int:
        """Period of the loop."""
        return round(1e9 / self.rate_hz)


class Control(Settings):
    """The control socket: who may command the running controller, and who may look at it."""

    socket_mode: str = Field(
        default="0660",
        pattern=r"0?[67][0-7]0",
        description="Permissions of the socket, octal digits as text; to connect is to write. Others are never let in: "
        "the last digit is 0.",
    )
    operate_group: str | None = Field(
        default=None,
        min_length=1,
        description="Group whose members may do everything; null: the host's own. Root and the controller's user may.",
    )
    observe_group: str | None = Field(
        default=None,
        min_length=1,
        description="Group whose members may only look: status, get, diff, log, candidate show; null: none.",
    )


_SWEEP_HZ = 20.0
"""A flexure with a spindle has its first resonance near 60 Hz; at 50 Hz the sweep threw the stage from end to end."""


class Start(Settings):
    """Soft start and stop, and what is checked on the way."""

    enable_s: SecondsOrZero = Field(default=0.1, description="Time the amplifier gets to come on, if it is switched.")
    check_s: Seconds | None = Field(
        default=0.2,
        description="Polarity and scale check of an axis, before the loops are closed for the first time after a "
        "start: on each axis in turn, once for the gauge and once for the stage. null leaves it out; simulation only.",
    )
    check_V: VoltsAboveZero = Field(default=5.0, description="Voltage step of the check.")
    check_um: Distance = Field(default=2.0, description="Set-point step of the check.")
    check_factor: Annotated[float, Field(strict=True, gt=1, le=1_000)] = Field(
        default=3.0, description="The answer may be so many times larger or smaller than expected."
    )
    lift_s: RampSeconds = Field(default=0.5, description="Time from the park voltage to the working point.")
    sweep_s: SecondsOrZero = Field(
        default=1.0, description="Time of the decaying sweep that wipes the hysteresis memory; 0 leaves it out."
    )
    sweep_turns: Annotated[float, Field(strict=True, ge=0.1, le=1_000)] = Field(
        default=5.0, description="Turns of the sweep."
    )
    sweep_um: Distance | None = Field(
        default=None, description="Its amplitude at the start; null: as the hysteresis model's memory needs."
    )
    settle_s: SecondsOrZero = Field(default=0.2, description="Rest at the working point, while the estimators settle.")
    authority_s: RampSeconds = Field(default=0.5, description="Time in which the correction is faded in.")
    ramp_s: RampSeconds = Field(default=0.5, description="Time from any voltage to the park voltage.")
    arm_within_s: NewStart[SecondsOrZero] = Field(
        default=30.0,
        description="`arm_on_start` waits so long after READY for sensors that have not sent a valid sample yet, and "
        "gives up for good; 0 does not wait.",
    )

    @model_validator(mode="after")
    def _sweep_below_resonance(self) -> Self:
        hz = self.sweep_turns / self.sweep_s if self.sweep_s > 0 else 0.0
        if hz > _SWEEP_HZ:
            raise ValueError(
                f"{self.sweep_turns:g} sweep_turns in {self.sweep_s:g} s, {hz:.3g} Hz, would "
                f"swing the stage on its flexure; at most {_SWEEP_HZ:g} Hz: sweep_s: "
                f"{self.sweep_turns / _SWEEP_HZ:g} or more, or 0 for no sweep"
            )
        return self


class Driver(Settings):
    """A driver, found by its entry point; what else stands here is checked by the driver itself."""

    model_config = ConfigDict(extra="allow", frozen=True)

    driver: str = Field(description="Name of the driver's entry point, see docs/write-a-driver.md.")
    without_watchdog: Flag = Field(
        default=False, description="Accept hardware that no watchdog brings to a safe state when the loop is dead."
    )

    @property
    def options(self) -> dict[str, Any]:
        """The driver's own keys."""
        return dict(self.model_extra or {})


class Simulation(Settings):
    """The plant behind the devices that `micromanip device simulate` plays: `driver`, and the keys of that driver."""

    model_config = ConfigDict(extra="allow", frozen=True)

    driver: str = Field(
        default="simulated", description="Entry point of the simulated cyclic driver that is the plant."
    )

    @property
    def options(self) -> dict[str, Any]:
        """The driver's own keys."""
        return dict(self.model_extra or {})


PLAUSIBLE_UM = (-1000.0, 1000.0)
"""Strain and stage samples outside count as invalid where a signal has no range of its own."""


class Signal(Settings):
    """An input of the loop."""

    driver: str = Field(description="Which driver it comes from.")
    channel: str | None = Field(
        default=None, description="The driver's name for it; the signal's own name if left out."
    )
    max_age_us: LargerIsWeaker[Live[Microseconds | None]] = Field(
        default=300.0, description="Older than this it counts as invalid; null means no limit."
    )
    range_um: WiderIsWeaker[Live[RangeUm | None]] = Field(
        default=None, description="Strain and stage samples outside are invalid; null: +-1000 um."
    )


class Output(Settings):
    """An output of the loop: a piezo voltage."""

    driver: str = Field(description="Which driver writes it.")
    channel: str | None = Field(
        default=None, description="The driver's name for it; the output's own name if left out."
    )
    range_V: AtRest[RangeV] = Field(description="No voltage outside this range is ever written.")
    slew_V_per_ms: AtRest[Speed] = Field(description="No voltage changes faster than this.")
    # not AtRest: an output at rest would move to another voltage without being armed
    park_V: Volts = Field(default=0.0, description="Voltage at rest and after a fault.")
    capacitance_uF: Positive | None = Field(default=None, description="Capacitance of the stack; with current_mA.")
    current_mA: Positive | None = Field(
        default=None, description="Current of the amplifier: an excitation's slew stays below current / capacitance."
    )

    @model_validator(mode="after")
    def _park_is_inside(self) -> Self:
        low, high = self.range_V
        if not low <= self.park_V <= high:
            raise ValueError(f"park_V {self.park_V:g} V is outside range_V {low:g}..{high:g} V")
        if (self.capacitance_uF is None) != (self.current_mA is None):
            raise ValueError("current_mA and capacitance_uF go together: give both, or neither")
        return self

    @property
    def fastest_V_per_s(self) -> float:
        """Fastest change that slew limit and amplifier current both allow."""
        slew = self.slew_V_per_ms * 1e3
        if self.capacitance_uF is None or self.current_mA is None:
            return slew
        return min(slew, 1e3 * self.current_mA / self.capacitance_uF)


class Trial(Settings):
    """A candidate tuning that was promoted is on trial, and taken back if it is worse than the one before."""

    trial_s: Seconds = Field(default=5.0, description="Length of the trial.")
    window_s: Seconds = Field(default=0.2, description="Time over which the error on trial is averaged.")
    error_factor: Annotated[float, Field(strict=True, ge=1, le=1_000_000)] = Field(
        default=2.0, description="The rms error may become so many times that of the last second before."
    )
    error_floor_um: DistanceOrZero = Field(default=0.1, description="So much more is always allowed.")


class Switch(Settings):
    """A digital output of the loop."""

    driver: str = Field(description="Which driver writes it.")
    channel: str | None = Field(
        default=None, description="The driver's name for it; the switch's own name if left out."
    )


class Heartbeat(Switch):
    """A digital output that toggles while the loop turns: for a watchdog on the amplifier's side."""

    period_ms: Milliseconds = Field(default=20.0, description="Time of one full turn, on and off.")


class Switches(Settings):
    """Digital outputs; all may be left out."""

    amplifier_enable: Switch | None = Field(default=None, description="1 while the amplifier should be on.")
    amplifier_reset: Switch | None = Field(
        default=None,
        description="1 for 0.2 s after `reset`: the amplifier, or a drive, may forget its fault; never by itself. With "
        "it `reset` is accepted in READY too.",
    )
    feed_hold: Switch | None = Field(
        default=None, description="1 while the machine should not feed: in a hold, and after a fault until reset."
    )
    heartbeat: Heartbeat | None = Field(default=None, description="Toggles while the loop turns.")


class Configuration(Settings):
    """The whole file."""

    schema_version: NewStart[Literal[2]] = Field(description="Version of this layout.")
    loop: NewStart[Loop]
    start: AtRest[Start] = Start()
    drivers: NewStart[dict[str, Driver]] = Field(
        min_length=1, max_length=MAX_DRIVERS, description="Buses and cards, or the simulated cell."
    )
    signals: NewStart[dict[str, Signal]] = Field(
        max_length=MAX_SIGNALS,
        description="Named strain_<axis>, stage_<axis> (capacitive), deviation_<axis> or, with reference.frame, "
        "tracker_<name>; true_strain_<axis>, "
        "true_stage_<axis>, path_error_<axis>, uncompensated_<axis> where a simulation knows them. Digital, 1 is good: "
        "enable, interlock, amplifier_ok_<axis>, temperature_ok_<axis>; retracted (1: the tool is out of the cut). "
        "part: 0, or the number of the part that is being made; tool: 0, or the number of the tool in the spindle; "
        "temperature: of the cell, degC; learning takes all three.",
    )
    outputs: NewStart[dict[str, Output]] = Field(max_length=MAX_OUTPUTS, description="Named voltage_<axis>.")
    switches: NewStart[Switches] = Switches()
    faults: LargerIsWeaker[Live[Faults]] = Faults()
    shadow: Live[Trial] = Trial()
    reference: AtRest[Reference] = Field(description="Where the set-points of the axes come from.")
    axes: NewStart[dict[str, Axis]] = Field(
        min_length=1, max_length=MAX_AXES, description="The axes of the manipulator."
    )
    control: NewStart[Control] = Control()
    learning: NewStart[Learning | None] = Field(
        default=None, description="Learn from part to part what of the path error repeats, and play it; null: neither."
    )
    arm_on_start: NewStart[Flag] = Field(
        default=False,
        description="Arm by itself, once, when READY or within `start.arm_within_s` of it; simulated drivers only.",
    )
    simulation: NewStart[Simulation | None] = Field(
        default=None,
        description="The plant behind the devices that `micromanip device simulate` plays; besides `driver` "
        "it takes the keys of that driver. `run` does not use it.",
    )

    @property
    def frame(self) -> Frame | None:
        """The tracker's frame, where there is one."""
        return self.reference.frame if isinstance(self.reference, Tracker) else None
