"""Figures of each second and minute, kept for months."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from .base import Settings

Days = Annotated[int, Field(strict=True, ge=1, le=36_500)]


class Trend(Settings):
    """Least, mean, greatest value and rms of each quantity, one row per second and one per minute, one file per day.

    Only whole days are removed, the oldest first; a day on which nothing ran does not count.
    """

    folder: str | None = Field(
        default=None,
        min_length=1,
        description="Where the files go, relative to the configuration; null: `trend` in the state directory.",
    )
    keep_days: Days = Field(default=400, description="So many days of minutes are kept.")
    keep_seconds_days: Days = Field(default=30, description="So many days of seconds are kept.")
    quota_MB: Annotated[float, Field(strict=True, ge=1, le=1_000_000)] = Field(
        default=3000.0,
        description="Beyond it the oldest seconds are removed, then the oldest minutes; never those of today.",
    )
