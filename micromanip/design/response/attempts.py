"""Measure, identify, and where the response or its model is not good enough with more of it: the one loop of that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

from .choice import Identified, Wanted, identify
from .excitation import Multisine
from .measured import measure

Array = NDArray[np.float64]
Recorded = tuple[Multisine, Array, Array]
"""What was played, and its records (n,) of input and output."""

ATTEMPTS = 3
_MORE = 2


@dataclass(frozen=True)
class Attempted:
    """The model, the output (n,) that it was found from, and how often it was measured."""

    found: Identified
    output: Array
    attempts: int


def identify_again(record: Callable[[int, int], Recorded], wanted: Wanted, what: str, look_for: str) -> Attempted:
    """The model of what `record` measures: it is given the attempt, from 0, and how many times more to play.

    Raises CheckFailed, "`what`, in 3 attempts: why. `look_for`", where none of the models is what is `wanted`.
    """
    problem = None
    for attempt in range(ATTEMPTS):
        wave, u, y = record(attempt, _MORE**attempt)
        found = identify(measure(wave, u, y), 1.0 / wave.rate_hz, wanted)
        if found.problem is None:
            return Attempted(found, y, attempt + 1)
        problem = found.problem
    raise CheckFailed(f"{what}, in {ATTEMPTS} attempts: {problem}. {look_for}")
