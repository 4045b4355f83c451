"""The tracker's own coordinates: which signals they are, and how the axes' deviations come of them."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from micromanip.quantities import Micrometres, Real
from micromanip.rt.laws.coordinate_transform import MAX_FRAME

from .base import Settings
from .key import NewStart

PREFIX = "tracker_"


class Frame(Settings):
    """Tracker coordinates to axes: deviation_<axis> = row of the matrix times the signals, plus the offset."""

    signals: NewStart[tuple[str, ...]] = Field(
        min_length=1, max_length=MAX_FRAME, description="Signals with the tracker's coordinates, named tracker_<name>."
    )
    matrix: tuple[tuple[Real, ...], ...] = Field(
        min_length=1, description="A row per axis, in the order of the section axes; a column per signal. um per unit."
    )
    offset_um: tuple[Micrometres, ...] | None = Field(default=None, description="Added, a number per axis; null: none.")

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if len(set(self.signals)) != len(self.signals):
            raise ValueError("signals: each coordinate once")
        for name in self.signals:
            if not name.startswith(PREFIX):
                raise ValueError(f"signals: {name} must be named {PREFIX}<name>")
        for row in self.matrix:
            if len(row) != len(self.signals):
                raise ValueError(f"matrix: a row has {len(row)} numbers, there are {len(self.signals)} signals")
        if self.offset_um is not None and len(self.offset_um) != len(self.matrix):
            raise ValueError(f"offset_um: {len(self.offset_um)} numbers for {len(self.matrix)} rows of the matrix")
        rank = int(np.linalg.matrix_rank(np.array(self.matrix), rtol=1e-6))
        if rank < len(self.matrix):
            raise ValueError(
                f"matrix: its rank is {rank}, so the {len(self.matrix)} axes can't move independently; a rotation has "
                "orthogonal rows"
            )
        return self
