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
)

from .records import EXCHANGE, HARMONICS, MAX_FAULTS, MOST_LATE


class _Options(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class BoucWen(_Options):
    """Bouc-Wen hysteresis in place of the Preisach operator."""

    linear_um_per_V: Positive = Field(default=1.15, description="Slope far from a turning point.")
    square_um_per_V2: Real = Field(default=-6e-4, description="Asymmetry of the loop.")
    fall_um_per_V: NotNegative = Field(default=0.45, description="Loss of slope right after a turn.")
    with_sign_per_V: Real = Field(default=0.03, description="Recovery of the slope while the loop opens.")
    without_sign_per_V: Real = Field(default=0.012, description="Recovery of the slope in either direction.")
    lag_share: Annotated[float, Field(ge=0, le=0.5)] = Field(
        default=0.08, description="Lagging share of the displacement: rate dependence."
    )
    lag_ms: Milliseconds = Field(default=3.0, description="Time constant of the lag.")


class SecondMode(_Options):
    """A second mode of the flexure: a mass on a spring from the lever, which pushes back on the actuator."""

    ratio: Annotated[float, Field(gt=1, le=20)] = Field(
        default=3.0, description="Ratio of its frequency to the first mode's."
    )
    stiffness_share: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.1, description="Ratio of its stiffness to the flexure's."
    )
    gain: Real = Field(default=0.1, description="Share of its motion that the stage sensor measures.")


class Plant(_Options):
    """One axis: amplifier, piezo stack, flexure, sensors."""

    preisach_c_um_per_V2: Positive = Field(default=9.5e-3, description="Density of the Preisach operator.")
    preisach_d_per_V: Positive = Field(default=0.016, description="Decay of the density with the loop's half width.")
    preisach_k1: Real = Field(default=0.30, description="Slope of the density over the loop's middle.")
    preisach_k2: Real = Field(default=-0.45, description="Curvature of the density over the loop's middle.")
    reversible_um: tuple[Real, Real, Real] = Field(
        default=(0.72, -2e-4, -2e-6), description="Reversible part: um per V, V^2, V^3."
    )
    bouc_wen: BoucWen | None = Field(default=None, description="Bouc-Wen hysteresis; null: the Preisach operator.")
    creep_per_operator: NotNegative = Field(
        default=0.005, description="Share of the displacement per creep operator, of which there are 13."
    )
    amplifier_range_V: RangeV = Field(default=(-20.0, 150.0), description="Range of the amplifier.")
    amplifier_Hz: Hertz = Field(default=900.0, description="Bandwidth of the amplifier.")
    amplifier_slew_V_per_ms: Speed = Field(default=40.0, description="Slew rate of the amplifier.")
    amplifier_noise_mV: NotNegative = Field(default=2.0, description="Noise of the amplifier, rms.")
    late_cycles: int = Field(default=0, ge=0, le=MOST_LATE, description="Delay of every voltage in cycles.")
    piezo_N_per_um: Positive = Field(default=400.0, description="Stiffness of the stack.")
    actuator_kg: Positive = Field(default=2.0, description="Moving mass of the stack.")
    lever: Positive = Field(default=5.31, description="Lever ratio of the flexure.")
    flexure_N_per_um: Positive = Field(default=2.0, description="Stiffness between lever and stage.")
    guide_N_per_um: Positive = Field(default=0.125, description="Stiffness of the stage's guide.")
    stage_kg: Positive = Field(default=12.0, description="Mass of stage and spindle.")
    damping: NotNegative = Field(default=0.04, description="Damping ratio of both modes.")
    strain_noise_nm: NotNegative = Field(default=55.0, description="White noise of the strain gauge, rms.")
    strain_hum_nm: NotNegative = Field(default=10.0, description="50 Hz hum of the strain gauge, amplitude.")
    second_mode: SecondMode | None = Field(default=None, description="A second mode of the flexure; null: none.")
    strain_range_um: Distance = Field(default=180.0, description="Range of the strain gauge, +-.")
    strain_bits: int = Field(default=16, ge=8, le=32, description="Resolution of the strain gauge.")
    stage_noise_nm: NotNegative = Field(default=12.0, description="Noise of the capacitive sensor, rms.")
    stage_range_um: Distance = Field(default=300.0, description="Range of the capacitive sensor, +-.")
    stage_zero_um: Micrometres = Field(default=329.9, description="Zero of the capacitive sensor in stage position.")
    acceleration_noise: NotNegative = Field(default=0.02, description="Noise of the accelerometer, m/s^2 rms.")
    ambient_step_K: Real = Field(default=2.0, description="Initial distance from thermal equilibrium.")


class Force(_Options):
    """Machining force on each axis."""

    start_s: SecondsOrZero = Field(
        default=3.0,
        description="Tool engagement after the loop's start; with lines after the amplifier's first start.",
    )
    static_N: Real = Field(default=80.0, description="Steady part.")
    rise_ms: Milliseconds = Field(default=20.0, description="Time constant of the steady part.")
    tooth_N: Real = Field(default=40.0, description="Amplitude at tooth passing.")
    tooth_Hz: Hertz = Field(default=200.0, description="Tooth-passing frequency.")
    harmonics: tuple[Real, ...] = Field(
        default=(), max_length=HARMONICS, description="Shares of tooth_N at 2, 3, ... times that frequency."
    )
    noise_N: NotNegative = Field(default=5.0, description="Coloured noise, rms.")


class Deviation(_Options):
    """Path deviation of the robot: slow path error plus joint oscillation, or a file."""

    file: str | None = Field(
        default=None,
        description="Table relative to the working directory with t_s and deviation_<axis>_um, evenly spaced, at most "
        "65536 rows; null: the sines below.",
    )
    start_s: SecondsOrZero = Field(default=5.0, description="Start of the file after the loop's start.")
    amplitudes_um: tuple[Micrometres, Micrometres, Micrometres] = Field(
        default=(130.0, 60.0, 30.0), description="Amplitudes of the path error."
    )
    joint_um: DistanceOrZero = Field(default=30.0, description="Amplitude of the joint oscillation.")
    joint_Hz: Hertz = Field(
        default=8.0,
        description="Frequency of the joint oscillation on the first axis; 3 % lower and higher on the others.",
    )


class TrackerOptions(_Options):
    """Laser tracker that measures the deviation."""

    rate_Hz: SampleRate = Field(default=1000.0, description="Samples per second.")
    latency_ms: MillisecondsOrZero = Field(default=1.0, description="Age of a sample when it arrives.")
    noise_um: DistanceOrZero = Field(default=0.5, description="Noise, rms.")
    coordinates: tuple[tuple[Real, ...], ...] | None = Field(
        default=None,
        description="Rows of factors on all axes' deviations for channels deviation_<axis>; null: its own axis.",
    )


class Lines(_Options):
    """Digital lines of amplifier and PLC: inputs enable, interlock, retracted, amplifier_ok_<axis> and
    temperature_ok_<axis>; outputs amplifier_enable, feed_hold and heartbeat.
    """

    retract_s: Seconds = Field(default=0.5, description="Time from feed-hold until the tool is out of the cut.")
    heartbeat_ms: Milliseconds | None = Field(
        default=None,
        description="Longest constant heartbeat; then the amplifier switches off. null: no watchdog.",
    )


class Bus(_Options):
    """A bus between loop and cell. What only a simulation knows, and the tracker, do not go by it."""

    input_rate_Hz: SampleRate = Field(description="Samples per second of gauges, capacitive sensors and lines.")
    input_latency_us: MicrosecondsOrZero = Field(default=0.0, description="From measurement to reception.")
    output_rate_Hz: SampleRate = Field(description="Writes per second of voltages and switches; the latest value wins.")
    output_latency_us: MicrosecondsOrZero = Field(default=0.0, description="From sending until the value acts.")


class Fault(_Options):
    """A fault at a set time."""

    channel: str = Field(description="Affected input channel, e.g. strain_x; exchange for the kind error.")
    kind: Literal["value", "offset", "scale", "freeze", "nan", "status", "drop", "thin", "spike", "drift", "error"] = (
        Field(
            description="value replaces the reading, offset adds to it, scale multiplies it, freeze repeats the last "
            "one, nan is not a number, status flags it as bad, drop withholds every sample, thin passes every n-th "
            "one, spike adds to one sample, drift adds so much a second, error fails the whole exchange."
        )
    )
    value: Real = Field(
        default=0.0,
        description="New value, offset or factor; n of thin; code of the failed exchange.",
    )
    at_s: SecondsOrZero = Field(description="Begin after the loop's start.")
    for_s: Seconds | None = Field(default=None, description="Duration; null: unlimited.")

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
        default=None, description="Simulated hardware that one controller may use at a time; null: none."
    )
    seed: Seed = Field(default=1, description="Seed of all noise.")
    axes: tuple[str, ...] = Field(default=("x", "y", "z"), min_length=1, max_length=3, description="Names of the axes.")
    plant: Plant = Plant()
    variation: dict[str, Plant] = Field(default={}, description="Plant of an axis, where it differs.")
    force: Force = Force()
    deviation: Deviation = Deviation()
    tracker: TrackerOptions = TrackerOptions()
    lines: Lines | None = Field(default=None, description="Digital lines; null: none.")
    bus: Bus | None = Field(
        default=None, description="A bus with its own rates and latencies; null: all values in every cycle."
    )
    faults: tuple[Fault, ...] = Field(default=(), max_length=MAX_FAULTS, description="Faults at set times.")
    coupling: Annotated[float, Field(ge=0, le=0.1)] = Field(
        default=0.015, description="Share of each axis' motion on the next axis; 2/3 of it on the one after."
    )
    couplings: tuple[tuple[Real, ...], ...] | None = Field(
        default=None,
        description="Matrix of the axes' motion (um per um; row: affected axis; 1 on the diagonal), in place of "
        "coupling; null: coupling.",
    )
    flexure_coupling: Annotated[float, Field(ge=-0.1, le=0.1)] = Field(
        default=0.0,
        description="Coupling through the flexure: static share of each stage's motion on the next stage, 2/3 of it "
        "on the one after, with the dynamics of the affected axis' mode.",
    )
