"""Where the set-points of the axes come from."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
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

    def at_swings(self, hertz: Iterable[float]) -> AxisTracker:
        """The same once each oscillation has found the nearest of `hertz` in its range, if there is any."""
        swings = list(hertz)
        return replace(self, oscillations=tuple(each.at_swing(swings) for each in self.oscillations))


class _Own(Settings):
    offset_um: Micrometres = Field(description="Constant part; V where the axis' mode is voltage.")
    start_s: SecondsOrZero = Field(default=0.0, description="When the movement begins, after tracking has begun.")


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
    """Sum of sinusoids, equation (25) and (13); it begins without a step."""

    source: Literal["sine"]
    sines: tuple[Sine, ...] = Field(min_length=1, max_length=MAX_SINES, description="The sinusoids, which are added.")


class File(Settings):
    """Samples from a CSV file with a header; a column per axis, by its name."""

    source: Literal["file"]
    # the memory of the samples is made when the loop starts
    path: NewStart[str] = Field(description="CSV file, relative to the configuration.")
    sample_rate_Hz: Hertz = Field(default=10_000.0, description="Rows per second; interpolated to the loop's rate.")


class Oscillation(Settings):
    """One way in which the robot's joints oscillate."""

    frequency_Hz: Hertz
    um_per_s: Speed = Field(description="How fast its amplitude changes (um per root second).")
    decay_per_s: NotNegative = Field(default=0.0, description="How fast it dies away by itself; 0: it does not.")
    range_percent: JointRange = Field(
        default=0.0,
        description="How far from frequency_Hz its own frequency is found and followed, as a factor, either way (50: "
        "from two thirds to one and a half times it); 0: it is taken for what was said.",
    )

    @property
    def range_Hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that may be found."""
        factor = 1.0 + 0.01 * self.range_percent
        return self.frequency_Hz / factor, self.frequency_Hz * factor

    def at_swing(self, hertz: Sequence[float]) -> Oscillation:
        """The same at the frequency that it finds of `hertz`."""
        low, high = self.range_Hz
        found = min(
            (each for each in hertz if low <= each <= high),
            key=lambda each: abs(math.log(each / self.frequency_Hz)),
            default=self.frequency_Hz,
        )
        return self.model_copy(update={"frequency_Hz": found})


class Steady(Settings):
    """What is so as long as the samples say nothing else: a second, narrow predictor is believed as far as they do."""

    jerk_um_per_s3: Positive | None = Field(default=None, description="As for the axis; null: the axis' own.")
    returns_Hz: NotNegative = Field(
        default=0.0, description="How often the slow path comes and goes, less than the joints swing; 0: it wanders."
    )


class AxisDeviation(Settings):
    """What is known of the deviation of one axis."""

    oscillations: tuple[Oscillation, ...] | None = Field(
        default=None,
        max_length=MAX_MODES,
        description="The joints' oscillations; [] for none, null for that of oscillation_Hz.",
    )
    jerk_um_per_s3: Positive | None = Field(default=None, description="As above; null: that of all axes.")
    noise_um: Distance | None = Field(default=None, description="As above; null: that of all axes.")
    steady: Steady | None = Field(
        default=None, description="What a second, narrow predictor knows; null: there is only the one."
    )

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
    """The path deviation, as a signal (laser tracker)."""

    source: Literal["signal"]
    predict: Flag = Field(
        default=True, description="Extrapolate to now by a Kalman filter; false holds the last sample."
    )
    sample_rate_Hz: Hertz = Field(default=1000.0, description="Rate of the signal.")
    oscillation_Hz: Hertz = Field(default=8.0, description="Frequency at which the robot's joints oscillate.")
    oscillation_um_per_s: Speed = Field(default=60.0, description="How fast that oscillation changes.")
    oscillation_range_percent: JointRange = Field(
        default=0.0,
        description="How far from oscillation_Hz its own frequency is found and followed, as a factor, either way (50: "
        "from two thirds to one and a half times it); 0: it is taken for what was said. It takes an amplitude that "
        "stands out from what oscillation_um_per_s lets change: some 50 um at 60, 4 um at 2.",
    )
    jerk_um_per_s3: Positive = Field(
        default=20000.0, description="How rough the rest of the path is (rms jerk, 1/sqrt(Hz))."
    )
    noise_um: Distance = Field(default=0.5, description="Noise of the signal, rms.")
    axes: dict[str, AxisDeviation] = Field(
        default={}, description="What is known of single axes beyond that: `micromanip fit tracker` finds it."
    )
    horizon_ms: Milliseconds = Field(
        default=20.0,
        description="Without a sample for longer the last position is held; no less than max_age_us of the signals.",
    )
    range_um: RangeUm = Field(
        default=(-300.0, 300.0),
        description="Samples outside are rejected: no such deviation is believed. What is believed and out of an axis' "
        "reach is followed to the end of its set-point.",
    )
    jump_um: Distance | None = Field(
        default=50.0, description="A sample that is further from where it is expected is rejected; null: none is."
    )
    frame: Frame | None = Field(
        default=None,
        description="The tracker's own coordinates, of which deviation_<axis> are computed; null: those are read.",
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
    """A position that is moved by hand: `micromanip jog`."""

    source: Literal["jog"]
    range_um: RangeUm = Field(description="How far it may be jogged.")
    speed_um_per_s: Speed = Field(default=50.0, description="How fast it moves.")
    target_um: Live[dict[str, Micrometres]] = Field(
        default={}, description="Where each axis goes; offset_um if left out."
    )

    @model_validator(mode="after")
    def _is_inside(self) -> Self:
        low, high = self.range_um
        for name, value in {"offset_um": self.offset_um, **self.target_um}.items():
            if not low <= value <= high:
                raise ValueError(f"{name} {value:g} is outside range_um {low:g}..{high:g}")
        return self


Reference = Annotated[Hold | Step | Sines | File | Tracker | Jog, Field(discriminator="source")]
