"""What a commissioned axis is judged by: the user's figures, or those that its own range and noise suggest."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from micromanip.quantities import Distance, Hertz, Milliseconds, Percent

from .base import Settings


class Accept(Settings):
    """Acceptance of an axis by `commission`; margins and drawn plants by `analyse margins` too."""

    frequencies_Hz: tuple[Hertz, ...] = Field(
        default=(1.0, 5.0, 10.0),
        min_length=1,
        max_length=8,
        description="Frequencies of the sines that the strain gauge must follow.",
    )
    stroke_um: Distance | None = Field(
        default=None,
        description="Stroke of the sines, peak to peak, about the middle of setpoint.range_um; null: half that range.",
    )
    sigma_um: Distance | None = Field(
        default=None,
        description="Largest rms of set-point minus gauge on each sine; null: root of the sum of the squares of 1 % "
        "of the stroke and 1.25 times the gauge's noise at rest.",
    )
    path_error_um: Distance | None = Field(
        default=None,
        description="Largest rms of reference minus stage on a sine of the lowest frequency; null: likewise of 1 % of "
        "its amplitude and 3 times the stage's noise.",
    )
    tracking_error_um: Distance | None = Field(
        default=None,
        description="Largest rms of the path error while following the tracker; null: likewise of 5 % of the "
        "uncompensated error and twice the tracker's noise.",
    )
    gain_margin_dB: Annotated[float, Field(strict=True, ge=1, le=40)] = Field(
        default=6.0, description="Least gain margin of both loops, up and down, at every slope of the hysteresis."
    )
    phase_margin_deg: Annotated[float, Field(strict=True, ge=5, le=90)] = Field(
        default=35.0, description="Least phase margin of both loops, both ways, at every slope of the hysteresis."
    )
    settling_ms: Milliseconds = Field(
        default=50.0,
        description="Longest settling time of a stage step of 10 ms, to 5 % or the noise at rest, whichever is wider.",
    )
    overshoot_percent: Annotated[float, Field(strict=True, ge=0, le=100)] = Field(
        default=40.0, description="Largest overshoot of that step beyond the noise at rest."
    )
    robust_percent: Percent = Field(
        default=90.0, description="Share of the drawn plants that must keep robust_sensitivity."
    )
    robust_sensitivity: Annotated[float, Field(strict=True, ge=1.2, le=20)] = Field(
        default=3.0, description="Largest Ms of this share of the drawn plants, see `analyse margins`."
    )
