"""Where the set-points of the axes come from."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from micromanip.quantities import (
    Degrees,
    Distance,
    Hertz,
    Micrometres,
    Milliseconds,
    NotNegative,
    Positive,
    RangeUm,
    SecondsOrZero,
    Speed,
)
from micromanip.rt.laws.reference import MAX_MODES, MAX_SINES

from .base import Flag, Settings
from .frame import Frame
from .key import Live, NewStart

JointRange = Annotated[float, Field(ge=0, le=60)]


_SURE_SHARE = 0.125
"""Bandwidth of a sure oscillation's filter, in terms of that of the path's: it lets an eighth of the noise through."""


@dataclass(frozen=True)
class AxisTracker:
    """The tracker of one axis, as its predictor needs it."""

    sample_rate_Hz: float
    oscillations: tuple[Oscillation, ...]
    jerk_um_per_s3: float
    noise_um: float
    predict: bool = True
    returns_Hz: float = 0.0
    steady: Steady | None = None

    @property
    def sure(self) -> AxisTracker | None:
        """The narrow predictor beside it, if there is one: what is so as long as nothing else is seen.

        A path of jerk q has a filter of the bandwidth ``(q / (s sqrt h))^(1/3)`` (noise s, h between samples), an
        oscillation that walks by ``b s sqrt(2 h)`` one of b.
        """
        if self.steady is None:
            return None
        jerk, step_s = self.steady.jerk_um_per_s3 or self.jerk_um_per_s3, 1.0 / self.sample_rate_Hz
        bandwidth = _SURE_SHARE * (jerk / (self.noise_um * math.sqrt(step_s))) ** (1.0 / 3.0)
        walk = bandwidth * self.noise_um * math.sqrt(2.0 * step_s)
        swinging = (each.model_copy(update={"um_per_s": min(each.um_per_s, walk)}) for each in self.oscillations)
        return replace(
            self,
            oscillations=tuple(swinging),
            jerk_um_per_s3=jerk,
            returns_Hz=self.steady.returns_Hz,
            steady=None,
        )


class _Own(Settings):
    offset_um: Micrometres = Field(description="Constant part; V where the axis' mode is voltage.")
    start_s: SecondsOrZero = Field(default=0.0, description="Start of the movement after tracking has begun.")


class Hold(_Own):
    """A constant."""

    source: Literal["hold"]


class Step(_Own):
    """A step."""

    source: Literal["step"]
    step_um: Micrometres = Field(description="Height of the step.")


class Sine(Settings):
    """One sinusoid."""

    amplitude_um: Micrometres = Field(description="Half of peak to peak.")
    frequency_Hz: Hertz
    phase_deg: Degrees = Field(default=0.0, description="Phase at start_s.")


class Sines(_Own):
    """Sum of sinusoids, equations (25) and (13); it begins without a step."""

    source: Literal["sine"]
    sines: tuple[Sine, ...] = Field(min_length=1, max_length=MAX_SINES, description="Sinusoids, which are added.")


class File(Settings):
    """Samples of a CSV file with a header; a column per axis, by its name."""

    source: Literal["file"]
    # the memory of the samples is made when the loop starts
    path: NewStart[str] = Field(description="CSV file, relative to the configuration.")
    sample_rate_Hz: Hertz = Field(default=10_000.0, description="Rows per second; interpolated to the loop's rate.")


class Oscillation(Settings):
    """An oscillation of the robot's joints."""

    frequency_Hz: Hertz
    um_per_s: Speed = Field(description="Rate of change of its amplitude (um per root second).")
    decay_per_s: NotNegative = Field(default=0.0, description="Decay rate; 0: undamped.")
    range_percent: JointRange = Field(
        default=0.0,
        description="Range about frequency_Hz, as a factor both ways, in which the frequency is estimated and "
        "followed (50: two thirds to one and a half times it); 0: fixed.",
    )

    @property
    def range_Hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that may be found."""
        factor = 1.0 + 0.01 * self.range_percent
        return self.frequency_Hz / factor, self.frequency_Hz * factor


class Steady(Settings):
    """What is so as long as the samples say nothing else: a second, narrow predictor is believed as far as they do."""

    jerk_um_per_s3: Positive | None = Field(
        default=None, description="Rms jerk for this predictor; null: the axis' own."
    )
    returns_Hz: NotNegative = Field(
        default=0.0, description="Rate at which the slow path returns, below the joints' frequencies; 0: it drifts."
    )


class AxisDeviation(Settings):
    """Model of one axis' deviation."""

    oscillations: tuple[Oscillation, ...] | None = Field(
        default=None,
        max_length=MAX_MODES,
        description="Oscillations of the joints; []: none; null: that of oscillation_Hz.",
    )
    jerk_um_per_s3: Positive | None = Field(default=None, description="Rms jerk of this axis; null: that of all axes.")
    noise_um: Distance | None = Field(default=None, description="Noise of this axis; null: that of all axes.")
    steady: Steady | None = Field(default=None, description="A second, narrow predictor; null: none.")

    @model_validator(mode="after")
    def _are_apart(self) -> Self:
        ordered = sorted(self.oscillations or (), key=lambda each: each.frequency_Hz)
        for lower, upper in itertools.pairwise(ordered):
            followed = lower.range_percent + upper.range_percent > 0.0
            if followed and lower.range_Hz[1] >= upper.range_Hz[0]:
                raise ValueError(
                    f"oscillations at {lower.frequency_Hz:g} and {upper.frequency_Hz:g} Hz could find the same "
                    "frequency: their range_percent must be smaller"
                )
        if ordered and self.steady is not None and self.steady.returns_Hz >= ordered[0].range_Hz[0]:
            raise ValueError(
                f"steady.returns_Hz {self.steady.returns_Hz:g} must be less than the lowest frequency of an "
                f"oscillation, {ordered[0].range_Hz[0]:.4g} Hz: the slow path would be one"
            )
        return self


class Tracker(Settings):
    """The path deviation as a signal (laser tracker)."""

    source: Literal["signal"]
    predict: Flag = Field(
        default=True, description="Extrapolate to now by a Kalman filter; false: hold the last sample."
    )
    sample_rate_Hz: Hertz = Field(default=1000.0, description="Rate of the signal.")
    oscillation_Hz: Hertz = Field(default=8.0, description="Frequency of the robot's joint oscillation.")
    oscillation_um_per_s: Speed = Field(
        default=60.0, description="Rate of change of its amplitude (um per root second)."
    )
    oscillation_range_percent: JointRange = Field(
        default=0.0,
        description="Range about oscillation_Hz, as a factor both ways, in which the frequency is estimated and "
        "followed (50: two thirds to one and a half times it); 0: fixed. The amplitude must stand out "
        "from oscillation_um_per_s: some 50 um at 60, 4 um at 2.",
    )
    jerk_um_per_s3: Positive = Field(default=20000.0, description="Rms jerk of the rest of the path, 1/sqrt(Hz).")
    noise_um: Distance = Field(default=0.5, description="Noise of the signal, rms.")
    axes: dict[str, AxisDeviation] = Field(
        default={}, description="Models of single axes, which `micromanip fit tracker` finds."
    )
    horizon_ms: Milliseconds = Field(
        default=20.0,
        description="Longest extrapolation without a sample; then the last position is held. At least max_age_us of "
        "the signals.",
    )
    range_um: RangeUm = Field(
        default=(-300.0, 300.0),
        description="Valid range of samples. The axis follows a valid deviation beyond its reach to the end of its "
        "set-point range.",
    )
    jump_um: Distance | None = Field(
        default=50.0, description="Largest distance of a sample from its expected value; null: no limit."
    )
    frame: Frame | None = Field(
        default=None,
        description="Coordinates of the tracker, from which deviation_<axis> are computed; null: none.",
    )

    def of(self, axis: str) -> AxisTracker:
        """What is known of `axis`: its own where it has some, else what is said of all."""
        own = self.axes.get(axis, AxisDeviation())
        common = Oscillation(
            frequency_Hz=self.oscillation_Hz,
            um_per_s=self.oscillation_um_per_s,
            range_percent=self.oscillation_range_percent,
        )
        return AxisTracker(
            sample_rate_Hz=self.sample_rate_Hz,
            oscillations=(common,) if own.oscillations is None else own.oscillations,
            jerk_um_per_s3=self.jerk_um_per_s3 if own.jerk_um_per_s3 is None else own.jerk_um_per_s3,
            noise_um=self.noise_um if own.noise_um is None else own.noise_um,
            predict=self.predict,
            steady=own.steady,
        )


class Jog(_Own):
    """A position moved by hand: `micromanip jog`."""

    source: Literal["jog"]
    range_um: RangeUm = Field(description="Range of the position.")
    speed_um_per_s: Speed = Field(default=50.0, description="Speed of the movement.")
    target_um: Live[dict[str, Micrometres]] = Field(
        default={}, description="Target of each axis; offset_um if missing."
    )

    @model_validator(mode="after")
    def _is_inside(self) -> Self:
        low, high = self.range_um
        for name, value in {"offset_um": self.offset_um, **self.target_um}.items():
            if not low <= value <= high:
                raise ValueError(f"{name} {value:g} is outside range_um {low:g}..{high:g}")
        return self


Reference = Annotated[Hold | Step | Sines | File | Tracker | Jog, Field(discriminator="source")]
