"""The tracker's own coordinates: which signals they are, and how the axes' deviations come of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Self

import numpy as np
from pydantic import Field, model_validator

from micromanip.quantities import Micrometres, Real
from micromanip.rt.laws.coordinate_transform import MAX_FRAME

from .base import Settings

if TYPE_CHECKING:
    from .model import Configuration

Finding = tuple[tuple[str | int, ...], str]
PREFIX = "tracker_"


class Frame(Settings):
    """Tracker coordinates to axes: deviation_<axis> = row of the matrix times the signals, plus the offset."""

    signals: tuple[str, ...] = Field(
        min_length=1, max_length=MAX_FRAME, description="Signals with the tracker's coordinates, named tracker_<name>."
    )
    matrix: tuple[tuple[Real, ...], ...] = Field(
        min_length=1, description="A row an axis, in the order of the section axes; a column a signal. um per unit."
    )
    offset_um: tuple[Micrometres, ...] | None = Field(default=None, description="Added, a number an axis; null: none.")

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


def frame_of(configuration: Configuration) -> Frame | None:
    """The tracker's frame, where the configuration has one."""
    return getattr(configuration.reference, "frame", None)


def frame_findings(configuration: Configuration) -> Iterator[Finding]:
    """A frame whose signals or axes are not those of the configuration; coordinates that nobody uses."""
    frame = frame_of(configuration)
    used = () if frame is None else frame.signals
    for name in configuration.signals:
        if name.startswith(PREFIX) and name not in used:
            yield ("signals", name), "no frame uses it; name it in reference.frame.signals"
    if frame is None:
        return
    for name in used:
        if name not in configuration.signals:
            yield ("reference", "frame", "signals"), f"the section signals has no {name}"
    if len(frame.matrix) != len(configuration.axes):
        yield (
            ("reference", "frame", "matrix"),
            f"{len(frame.matrix)} rows for {len(configuration.axes)} axes ({', '.join(configuration.axes)})",
        )
    for name in configuration.axes:
        if f"deviation_{name}" in configuration.signals:
            yield ("signals", f"deviation_{name}"), "reference.frame computes it already; one of the two must go"
