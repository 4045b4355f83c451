"""The tracker's own coordinates: which signals they are, and how the axes' deviations come of them."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from micromanip.quantities import Micrometres, Real
from micromanip.rt.laws.coordinate_transform import MAX_FRAME

from .base import Settings
from .key import NewStart

PREFIX = "tracker_"
_UM_PER_MM = 1000.0
_SKEW = 1e-3
"""How far the rows of a rotation may be from orthogonal and of one length, in terms of that length."""


class Lever(Settings):
    """The tracker's target is not where the tool cuts: what a rotation of the workpiece moves between the two.

    deviation += 1000 um/mm (R theta) x arm_mm, with theta the rotation vector of the signals and R the rotation of the
    matrix: exact to half the square of the angle, .05 um of 100 mm at 1 mrad.
    """

    signals: NewStart[tuple[str, str, str]] = Field(
        description="Rotation of the target from the programmed one about the tracker's three axes, named "
        f"{PREFIX}<name>; small angles, right-handed."
    )
    rad_per_unit: Real = Field(default=1e-3, description="Angle per unit of those signals; 0.001: mrad.")
    arm_mm: tuple[Real, Real, Real] = Field(
        description="Vector from the target to the tool's point, along the cell's axes. It holds for the whole path; "
        "if the target travels far beside the path, let the tracker's software compute the tool's point."
    )


class Frame(Settings):
    """Tracker coordinates to axes: deviation_<axis> = row of the matrix times the signals, plus the offset."""

    signals: NewStart[tuple[str, ...]] = Field(
        min_length=1, max_length=MAX_FRAME, description="Signals with the tracker's coordinates, named tracker_<name>."
    )
    matrix: tuple[tuple[Real, ...], ...] = Field(
        min_length=1, description="A row per axis, in the order of the section axes; a column per signal; um per unit."
    )
    offset_um: tuple[Micrometres, ...] | None = Field(default=None, description="Offset of each axis; null: none.")

    lever: Lever | None = Field(
        default=None,
        description="Lever from the tracker's target to the tool's point; null: no lever, or no rotation.",
    )

    @property
    def sources(self) -> tuple[str, ...]:
        """All signals of the tracker: coordinates, then rotations."""
        return self.signals if self.lever is None else (*self.signals, *self.lever.signals)

    @property
    def whole_matrix(self) -> tuple[tuple[float, ...], ...]:
        """A row per axis, a column per entry of `sources`."""
        if self.lever is None:
            return self.matrix
        return tuple(tuple(row) for row in np.hstack([np.array(self.matrix), self._turned(self.lever)]).tolist())

    def _turned(self, lever: Lever) -> NDArray[np.float64]:
        """Columns (3, 3): um per unit of each rotation, ``-[arm]x R``."""
        x, y, z = lever.arm_mm
        cross = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # times theta: theta x arm
        rotation = np.array(self.matrix) / np.linalg.norm(self.matrix[0])
        return np.asarray(_UM_PER_MM * lever.rad_per_unit * cross @ rotation)

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if len(set(self.sources)) != len(self.sources):
            raise ValueError("signals: each coordinate once")
        for name in self.sources:
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

    @model_validator(mode="after")
    def _has_a_lever(self) -> Self:
        if self.lever is None:
            return self
        if len(self.matrix) != len(self.signals) or len(self.signals) != 3:
            raise ValueError(
                f"lever: {len(self.matrix)} axes and {len(self.signals)} signals; it needs three of each: a rotation "
                "moves the tool along three axes, and about which it turns follows from the matrix"
            )
        turn = np.array(self.matrix)
        scale = float(np.linalg.norm(turn[0]))
        if not np.allclose(turn @ turn.T, scale**2 * np.eye(3), rtol=0.0, atol=_SKEW * scale**2):
            raise ValueError(
                "lever: the matrix must be a rotation times um per unit; its rows are not orthogonal or of one length"
            )
        if np.linalg.det(turn) < 0.0:
            raise ValueError("lever: the matrix is a reflection; its angles would turn the wrong way round")
        if not any(self.lever.arm_mm) or self.lever.rad_per_unit == 0.0:
            raise ValueError("lever: nothing comes of an arm of 0 mm, or of 0 rad a unit; leave the section out")
        return self
