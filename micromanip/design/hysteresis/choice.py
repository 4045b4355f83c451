"""The choice among kinds of models: by the cost on what was fitted *and* the error on what was not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.settings.schema.hysteresis import Range

from .fit import HysteresisFit, fit, structure_of
from .structure import Structure

Array = NDArray[np.float64]

_FITTED_SHARE = 0.7
_STARTS = {"pi-free": 2}


@dataclass(frozen=True)
class Candidate:
    """A structure, its error (percent rms) on the first part of the record and on the rest."""

    structure: Structure
    fitted_percent: float
    held_out_percent: float


def candidates(voltage_V: Array, step_s: float, plays: int = 10) -> list[Structure]:
    """What is tried: every kind, with and without creep."""
    kinds = ("pi-affine", "pi-tanh", "rate", "pi-free")
    return [structure_of(kind, voltage_V, step_s, plays, creep) for kind in kinds for creep in (False, True)]


def starts_for(structure: Structure) -> int:
    """How many starts the fit of a structure is worth."""
    return _STARTS.get(structure.name.removesuffix("+creep"), 6)


def choose(
    structures: list[Structure],
    voltage_V: Array,
    displacement_um: Array,
    range_um: Range,
    burn_in: int,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[HysteresisFit, list[Candidate]]:
    """Best of `structures`: each is fitted to the first 70 % and judged on the rest; the winner is fitted to all.

    The figure of merit is the larger of the two errors: a model must neither leave out what is in the record nor
    invent what is not. The candidates come back best first.
    """
    count = burn_in + round(_FITTED_SHARE * (len(voltage_V) - burn_in))
    tried = []
    for structure in structures:
        progress(structure.name)
        try:
            first = fit(structure, voltage_V[:count], displacement_um[:count], range_um, burn_in, starts_for(structure))
        except ValueError:
            continue  # this kind has no invertible model of the record
        held_out = first.held_out(voltage_V, displacement_um, count)[0]
        tried.append(Candidate(structure, first.rms_percent, held_out))
    if not tried:
        raise ValueError("no kind of model fits; the record may not show a hysteresis loop")
    tried.sort(key=lambda candidate: max(candidate.fitted_percent, candidate.held_out_percent))
    progress(f"{tried[0].structure.name}, on the whole record")
    best = fit(tried[0].structure, voltage_V, displacement_um, range_um, burn_in, starts_for(tried[0].structure))
    return best, tried
