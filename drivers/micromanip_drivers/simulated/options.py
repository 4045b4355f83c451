"""Figures of the simulated cell, as they may stand under its driver in the configuration."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from micromanip.driver.quantities import (
    Distance,
    DistanceOrZero,
    Hertz,
    Micrometres,
    MicrosecondsOrZero,
    Milliseconds,
    MillisecondsOrZero,
    NotNegative,
    Positive,
    RangeV,
    Real,
    SampleRate,
    Seconds,
    SecondsOrZero,
    Seed,
    Speed,
    Volts,
    VoltsAboveZero,
)

from .records import EXCHANGE, HARMONICS, MAX_FAULTS, MOST_LATE


class _Options(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class BoucWen(_Options):
    """Hysteresis of Bouc and Wen in place of the Preisach operator."""

    linear_um_per_V: Positive = Field(default=1.15, description="Slope far from a turning point.")
    square_um_per_V2: Real = Field(default=-6e-4, description="Asymmetry of the loop.")
    fall_um_per_V: NotNegative = Field(default=0.45, description="What the slope loses right after a turn.")
    with_sign_per_V: Real = Field(default=0.03, description="How fast it comes back while the loop opens.")
    without_sign_per_V: Real = Field(default=0.012, description="The same, whichever way the loop goes.")
    lag_share: Annotated[float, Field(ge=0, le=0.5)] = Field(
        default=0.08, description="Share of the displacement that lags: rate dependence."
    )
    lag_ms: Milliseconds = Field(default=3.0, description="Time constant of that lag.")


class SecondMode(_Options):
    """A second mode of the flexure: a mass on a spring from the lever, which pushes back on the actuator."""

    ratio: Annotated[float, Field(gt=1, le=20)] = Field(default=3.0, description="Its frequency over the first one's.")
    stiffness_share: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.1, description="Its spring's stiffness over the flexure's: how much it pushes back."
    )
    gain: Real = Field(default=0.1, description="Share of its swing that the stage sensor sees.")


class Plant(_Options):
    """One axis: amplifier, piezo stack, flexure, sensors."""

    preisach_c_um_per_V2: Positive = Field(default=9.5e-3, description="Density of the Preisach operator.")
    preisach_d_per_V: Positive = Field(default=0.016, description="Decay of the density with the loop's half width.")
    preisach_k1: Real = Field(default=0.30, description="Slope of the density over the loop's middle.")
    preisach_k2: Real = Field(default=-0.45, description="Curvature of the density over the loop's middle.")
    reversible_um: tuple[Real, Real, Real] = Field(
        default=(0.72, -2e-4, -2e-6), description="Reversible part: um per V, V^2, V^3."
    )
    bouc_wen: BoucWen | None = Field(default=None, description="In place of the Preisach operator; null: that.")
    saturation_V: Volts = Field(default=-20.0, description="Negative saturation.")
    creep_per_operator: NotNegative = Field(
        default=0.005, description="Share of the displacement that each of the 13 creep operators delays."
    )
    amplifier_range_V: RangeV = Field(default=(-20.0, 150.0), description="Range of the amplifier.")
    amplifier_Hz: Hertz = Field(default=900.0, description="Bandwidth of the amplifier.")
    amplifier_slew_V_per_ms: Speed = Field(default=40.0, description="Slew rate of the amplifier.")
    amplifier_noise_mV: NotNegative = Field(default=2.0, description="Noise of the amplifier, rms.")
    late_cycles: int = Field(default=0, ge=0, le=MOST_LATE, description="Cycles by which every voltage comes later.")
    dac_bits: int = Field(default=16, ge=8, le=32, description="Resolution of the output over dac_span_V.")
    dac_span_V: VoltsAboveZero = Field(default=300.0, description="Span of the output converter.")
    piezo_N_per_um: Positive = Field(default=400.0, description="Stiffness of the stack.")
    actuator_kg: Positive = Field(default=2.0, description="Mass that moves with the stack.")
    lever: Positive = Field(default=5.31, description="Lever ratio of the flexure.")
    flexure_N_per_um: Positive = Field(default=2.0, description="Stiffness between lever and stage.")
    guide_N_per_um: Positive = Field(default=0.125, description="Stiffness of the stage's guide.")
    stage_kg: Positive = Field(default=12.0, description="Mass of stage and spindle.")
    damping: NotNegative = Field(default=0.04, description="Damping ratio of both modes.")
    strain_noise_nm: NotNegative = Field(default=55.0, description="White noise of the strain gauge, rms.")
    strain_hum_nm: NotNegative = Field(default=10.0, description="50 Hz hum of the strain gauge, amplitude.")
    strain_Hz: Hertz = Field(default=2500.0, description="Bandwidth of the strain gauge.")
    second_mode: SecondMode | None = Field(default=None, description="A second mode of the flexure; null: none.")
    strain_range_um: Distance = Field(default=180.0, description="The strain gauge reads +- this, in strain_bits.")
    strain_bits: int = Field(default=16, ge=8, le=32, description="Resolution of the strain gauge over its range.")
    stage_noise_nm: NotNegative = Field(default=12.0, description="Noise of the capacitive sensor, rms.")
    stage_range_um: Distance = Field(default=300.0, description="The capacitive sensor reads +- this.")
    stage_zero_um: Micrometres = Field(
        default=329.9, description="Stage position at which the capacitive sensor reads 0."
    )
    acceleration_noise: NotNegative = Field(default=0.02, description="Noise of the accelerometer, m/s^2 rms.")
    drift_um_per_K: Real = Field(default=0.5, description="Thermal drift of the stage.")
    drift_time_constant_s: Seconds = Field(default=600.0, description="Time constant of the drift.")
    ambient_step_K: Real = Field(default=2.0, description="How far the cell is from its thermal balance at the start.")


class Force(_Options):
    """Machining force on each axis."""

    start_s: SecondsOrZero = Field(
        default=3.0,
        description="When the tool engages, after the loop's start; with lines, after the amplifier's first start.",
    )
    static_N: Real = Field(default=80.0, description="Steady part.")
    rise_ms: Milliseconds = Field(default=20.0, description="Time constant of the steady part.")
    tooth_N: Real = Field(default=40.0, description="Amplitude at tooth passing.")
    tooth_Hz: Hertz = Field(default=200.0, description="Tooth-passing frequency.")
    harmonics: tuple[Real, ...] = Field(
        default=(), max_length=HARMONICS, description="Shares of tooth_N at 2, 3, .. times that frequency."
    )
    teeth: int = Field(default=4, ge=1, le=64, description="Teeth of the tool: the spindle turns so much more slowly.")
    runout: Real = Field(default=0.0, description="Share of tooth_N once a turn of the spindle: its tool runs out.")
    speed_percent: Annotated[float, Field(ge=-20, le=20)] = Field(
        default=0.0, description="Change of the spindle's speed, as under load."
    )
    speed_after_s: SecondsOrZero = Field(default=0.0, description="When it begins, after the tool has engaged.")
    speed_within_s: Seconds = Field(default=0.1, description="How long it takes, evenly.")
    noise_N: NotNegative = Field(default=5.0, description="Coloured noise, rms.")
    noise_Hz: Hertz = Field(default=30.0, description="Bandwidth of the coloured noise.")


class Deviation(_Options):
    """Path deviation of the robot: slow path error plus oscillation of the joints, or what a file says."""

    file: str | None = Field(
        default=None,
        description="Table that is played instead, relative to the working directory: t_s and deviation_<axis>_um, "
        "even rows, at most 65536; null: the sines below.",
    )
    start_s: SecondsOrZero = Field(default=5.0, description="When the file begins, after the loop's start.")
    amplitudes_um: tuple[Micrometres, Micrometres, Micrometres] = Field(
        default=(130.0, 60.0, 30.0), description="Path error."
    )
    frequencies_Hz: tuple[Hertz, Hertz, Hertz] = Field(default=(0.11, 0.29, 0.83), description="Path error.")
    joint_um: DistanceOrZero = Field(default=30.0, description="Amplitude of the joint oscillation.")
    joint_Hz: Hertz = Field(
        default=8.0, description="Its frequency on the first axis; 3 % lower and higher on the others."
    )


class TrackerOptions(_Options):
    """Laser tracker that sees the deviation."""

    rate_Hz: SampleRate = Field(default=1000.0, description="Samples a second.")
    latency_ms: MillisecondsOrZero = Field(default=1.0, description="Age of a sample when it arrives.")
    noise_um: DistanceOrZero = Field(default=0.5, description="Noise, rms.")
    coordinates: tuple[tuple[Real, ...], ...] | None = Field(
        default=None,
        description="What the channels deviation_<axis> read: a row of factors on the deviations of all axes each; "
        "null: each its own axis.",
    )


class Lines(_Options):
    """Digital lines of amplifier and PLC: inputs enable, interlock, retracted, amplifier_ok_<axis> and
    temperature_ok_<axis>; outputs amplifier_enable, feed_hold and heartbeat.
    """

    retract_s: Seconds = Field(default=0.5, description="From feed-hold until the tool is out of the cut.")
    amplifier_bleed_ms: Milliseconds = Field(
        default=20.0, description="Time constant with which a disabled amplifier discharges the stack."
    )
    heartbeat_ms: Milliseconds | None = Field(
        default=None,
        description="The enabled amplifier switches itself off when the heartbeat has not changed for this long; "
        "null: it does not watch.",
    )


class Bus(_Options):
    """A bus between loop and cell. What only a simulation knows, and the tracker, do not go by it."""

    input_rate_Hz: SampleRate = Field(description="Samples a second of gauges, capacitive sensors and lines.")
    input_latency_us: MicrosecondsOrZero = Field(default=0.0, description="From being measured to being received.")
    output_rate_Hz: SampleRate = Field(description="Writes a second of voltages and switches; the latest value wins.")
    output_latency_us: MicrosecondsOrZero = Field(default=0.0, description="From being sent to being in force.")


class Fault(_Options):
    """A fault that comes at a set time."""

    channel: str = Field(description="Input channel that it befalls, e.g. strain_x; exchange for the kind error.")
    kind: Literal["value", "offset", "scale", "freeze", "nan", "status", "drop", "thin", "spike", "error"] = Field(
        description="value replaces the reading, offset adds to it, scale multiplies it, freeze repeats the last one, "
        "nan is not a number, status flags it as bad, drop lets no sample come, thin only each so many-th, spike "
        "adds to one sample, error fails the whole exchange."
    )
    value: Real = Field(
        default=0.0,
        description="What is put in, added or multiplied by; thin's number; the code with which an exchange fails.",
    )
    at_s: SecondsOrZero = Field(description="When it begins, after the loop's start.")
    for_s: Seconds | None = Field(default=None, description="How long it lasts; null: for ever.")

    @model_validator(mode="after")
    def _error_is_of_the_exchange(self) -> Fault:
        if (self.kind == "error") != (self.channel == EXCHANGE):
            raise ValueError(f"kind: error goes with the channel {EXCHANGE}, and every other kind with an input")
        if self.kind == "error" and not (self.value.is_integer() and 1 <= self.value < 2**31):
            raise ValueError(f"value: the code of a failed exchange is a whole number from 1, not {self.value:g}")
        if self.kind == "thin" and not (self.value.is_integer() and 2 <= self.value < 2**31):
            raise ValueError(f"value: thin lets each so many-th sample come, a whole number from 2, not {self.value:g}")
        if self.kind == "spike" and self.for_s is not None:
            raise ValueError("for_s: a spike is one sample; leave it out")
        return self


class Options(_Options):
    """Keys of the driver `simulated`."""

    driver: str = "simulated"
    device: str | None = Field(
        default=None, description="Pretended hardware that only one controller may use at a time; null: none."
    )
    seed: Seed = Field(default=1, description="Seed of all noise.")
    axes: tuple[str, ...] = Field(default=("x", "y", "z"), min_length=1, max_length=3, description="Names of the axes.")
    plant: Plant = Plant()
    variation: dict[str, Plant] = Field(default={}, description="An axis' own plant, where it differs.")
    force: Force = Force()
    deviation: Deviation = Deviation()
    tracker: TrackerOptions = TrackerOptions()
    lines: Lines | None = Field(default=None, description="Digital lines; null: there are none.")
    bus: Bus | None = Field(
        default=None, description="A bus with its own rates and latencies; null: every sample and output in its cycle."
    )
    faults: tuple[Fault, ...] = Field(default=(), max_length=MAX_FAULTS, description="Faults that come at set times.")
    coupling: Annotated[float, Field(ge=0, le=0.1)] = Field(
        default=0.015, description="Share of each axis' motion that the next axis sees; the one after sees 2/3 of it."
    )
    couplings: tuple[tuple[Real, ...], ...] | None = Field(
        default=None,
        description="What each axis (row) sees of the motion of each (column), um per um, 1 on the diagonal, in place "
        "of the option coupling; null: that.",
    )
    flexure_coupling: Annotated[float, Field(ge=-0.1, le=0.1)] = Field(
        default=0.0,
        description="Parasitic motion through the flexure: each stage pushes on the next so that it moves by this "
        "share at rest, and 2/3 of it on the one after, and swings with the mode of the axis that is pushed.",
    )
