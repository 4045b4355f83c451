"""The choice among kinds of models: by the cost on what was fitted *and* the error on what was not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from micromanip.control.system import Array
from micromanip.settings.schema.hysteresis import Range

from .fit import Flags, HysteresisFit, counting, delayed, fit, structure_of
from .structure import Structure

_FITTED_SHARE = 0.7
_DELAYS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 20.0)
_LATEST_S, _LATEST_SAMPLES = 2e-3, 2.0
"""Dead times that are tried, in samples; what is later than both of these is dynamics, which other records show."""
_WORTH = 0.97
"""A dead time is taken where the error falls below this share: it is one parameter more."""
_ALIKE = 1.15
"""Of kinds whose errors are within this factor of the least, the one with the fewest parameters is taken: where a
record repeats itself, as a sine does, its rest can't tell that rate and creep stand in for one another.
"""


@dataclass(frozen=True)
class Candidate:
    """A kind of model, its error (percent rms) on the first part of the record and on the rest."""

    name: str
    fitted_percent: float
    held_out_percent: float
    structure: Structure | None = None
    delay_samples: float = 0.0

    @property
    def merit(self) -> float:
        """The larger of the errors: a model must neither leave out what is there nor invent what is not."""
        return max(self.fitted_percent, self.held_out_percent)


def candidates(voltage_V: Array, step_s: float, plays: int = 10) -> list[Structure]:
    """What is tried: every kind, with and without creep."""
    kinds = ("pi-affine", "pi-tanh", "rate", "pi-free")
    return [structure_of(kind, voltage_V, step_s, plays, creep) for kind in kinds for creep in (False, True)]


def _starts(structure: Structure) -> int:
    return 2 if structure.free else 6


def parted(used: Flags) -> tuple[int, Flags]:
    """The end of the first 70 % of the samples that count (n,), and those behind it."""
    at = np.flatnonzero(used)
    count = int(at[round(_FITTED_SHARE * len(at))])
    return count, used & (np.arange(len(used)) >= count)


def choose(
    structures: list[Structure],
    voltage_V: Array,
    displacement_um: Array,
    range_um: Range,
    burn_in: int | Flags,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[HysteresisFit, list[Candidate]]:
    """Best of `structures`: each is fitted to the first 70 % and judged on the rest; the winner is fitted to all.

    Of kinds that are as good the simplest wins; it is tried behind dead times, too. The candidates come back with the
    least error first.
    """
    used = counting(len(voltage_V), burn_in)
    count, rest = parted(used)
    v, y = voltage_V[:count], displacement_um[:count]
    tried: list[Candidate] = []
    fits: list[HysteresisFit] = []
    for number, structure in enumerate(structures, start=1):
        progress(f"{structure.name}, {number} of {len(structures)} kinds")
        try:
            first = fit(structure, v, y, range_um, used[:count], _starts(structure))
        except ValueError:
            continue  # this kind has no invertible model of the record
        fits.append(first)
        tried.append(_candidate(first, voltage_V, displacement_um, rest))
    if not tried:
        raise ValueError("no kind of model fits; the record may not show a hysteresis loop")
    least = min(candidate.merit for candidate in tried)
    alike = [k for k, candidate in enumerate(tried) if candidate.merit <= _ALIKE * least]
    best = min(alike, key=lambda k: (len(fits[k].x), tried[k].merit))
    chosen = tried[best]
    progress(f"{tried[best].name} behind a dead time")
    late = _with_dead_time(fits[best], tried[best], voltage_V, displacement_um, used, rest, range_um)
    if late is not None:
        tried.append(late)
        chosen = late
    tried.sort(key=lambda candidate: candidate.merit)
    progress(f"{chosen.name}, on the whole record")
    structure = chosen.structure or structures[0]
    whole = fit(structure, voltage_V, displacement_um, range_um, used, _starts(structure))
    if chosen.delay_samples:
        behind = delayed(whole, chosen.delay_samples, voltage_V, displacement_um, used, range_um)
        whole = behind if behind.rms_um < whole.rms_um else whole
    return whole, tried


def _candidate(first: HysteresisFit, v: Array, y: Array, rest: Flags) -> Candidate:
    late = first.delay_samples
    name = first.structure.name + ("+delay" if late else "")
    return Candidate(name, first.rms_percent, first.held_out(v, y, rest)[0], first.structure, late)


def _with_dead_time(
    first: HysteresisFit, plain: Candidate, v: Array, y: Array, used: Flags, rest: Flags, range_um: Range
) -> Candidate | None:
    """The best dead time, or None where none is worth it."""
    count = int(np.flatnonzero(rest)[0])
    best, limit = plain, max(_LATEST_SAMPLES, _LATEST_S / first.structure.step_s)
    for samples in _DELAYS:
        if samples > limit:
            break
        try:
            fitted = delayed(first, samples, v[:count], y[:count], used[:count], range_um)
        except ValueError:
            continue  # no inverse
        found = _candidate(fitted, v, y, rest)
        best = found if found.merit < best.merit else best
    return best if best.merit < _WORTH * plain.merit else None
