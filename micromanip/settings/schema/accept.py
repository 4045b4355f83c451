"""What a commissioned axis is judged by: the user's figures, or those that its own range and noise suggest."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from micromanip.quantities import Distance, Hertz, Milliseconds, Percent

from .base import Settings


class Accept(Settings):
    """Acceptance of an axis by `commission`; margins and drawn plants by `analyse margins` too."""

    frequencies_Hz: tuple[Hertz, ...] = Field(
        default=(1.0, 5.0, 10.0), min_length=1, max_length=8, description="Sines that the strain gauge is to follow."
    )
    stroke_um: Distance | None = Field(
        default=None,
        description="Their stroke, peak to peak, about the middle of setpoint.range_um; null: half of that range.",
    )
    sigma_um: Distance | None = Field(
        default=None,
        description="Rms of set-point minus gauge on each; null: 1 % of the stroke and 1.25 times the gauge's "
        "noise at rest, the root of the sum of their squares.",
    )
    path_error_um: Distance | None = Field(
        default=None,
        description="Rms of reference minus stage on a path, a sine of the lowest of these frequencies; null: 1 % of "
        "its amplitude and 3 times the stage's noise at rest, likewise.",
    )
    tracking_error_um: Distance | None = Field(
        default=None,
        description="Rms of the path error of the tuned file as it will run, following the tracker; null: 5 % of the "
        "uncompensated error and twice the tracker's noise, likewise.",
    )
    gain_margin_dB: Annotated[float, Field(strict=True, ge=1, le=40)] = Field(
        default=6.0, description="Of both loops, up and down, at every slope."
    )
    phase_margin_deg: Annotated[float, Field(strict=True, ge=5, le=90)] = Field(
        default=35.0, description="Of both loops, either way, at every slope."
    )
    settling_ms: Milliseconds = Field(
        default=50.0, description="Of a step of the stage in 10 ms, to 5 % or to its noise at rest, whichever is wider."
    )
    overshoot_percent: Annotated[float, Field(strict=True, ge=0, le=100)] = Field(
        default=40.0, description="Of that step, beyond its noise at rest."
    )
    robust_percent: Percent = Field(default=90.0, description="Share of the drawn plants for which Ms stays below:")
    robust_sensitivity: Annotated[float, Field(strict=True, ge=1.2, le=20)] = Field(
        default=3.0, description="Ms that this share of the drawn plants must keep, see `analyse margins`."
    )
