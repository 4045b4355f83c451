"""How much a record has shown of a hysteresis: a model of little fits well, and says nothing of the rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .network import reversals
from .record import Record

_TURN, _MINOR = 0.05, 0.8
"""Share of the input's stroke by which it comes back where it turns; a shorter way between turns is a minor loop's."""
_TURNS, _MINORS = 8, 2
_CREEP_S, _PARTS = 1.0, 4.0
"""Creep of that time constant should show; what is slower than so much of a record does not."""
_COVERED = 0.7
"""The least share of the set-point's range: `identify` covers three quarters."""


def little_seen(record: Record, used: NDArray[np.bool_], setpoint_um: tuple[float, float] | None = None) -> list[str]:
    """What is to be told of the samples that are `used` (n,): empty where they have shown all that a model needs.

    `setpoint_um` is the range of the set-point that the model is for, where that is known.
    """
    at = np.flatnonzero(used)
    u, y = record.u[at[0] : at[-1] + 1], record.y[used]
    stroke_V, seconds = float(np.ptp(u)), len(at) * record.step_s
    turns = np.flatnonzero(reversals(u, _TURN * stroke_V))
    ways = np.abs(np.diff(u[turns]))
    missing = []
    if np.count_nonzero(ways < _MINOR * stroke_V) < _MINORS:
        missing.append("minor loops")
    if seconds < _PARTS * _CREEP_S:
        missing.append(f"creep slower than {seconds / _PARTS:.2g} s")
    told = []
    if missing or len(turns) < _TURNS:
        unseen = f", in which {' and '.join(missing)} did not show" if missing else ""
        told.append(
            f"fitted to {seconds:.3g} s with {len(turns)} turns over {np.ptp(y):.4g} um{unseen}: the figures hold "
            "for no more than that; record longer, with turns at many places, or look at --validate"
        )
    if setpoint_um is not None:
        low, high = setpoint_um
        covered = (min(high, float(y.max())) - max(low, float(y.min()))) / (high - low)
        if covered < _COVERED:
            told.append(
                f"{record.output_name} covers {100.0 * max(covered, 0.0):.0f} % of the set-point's range, {low:g} to "
                f"{high:g} um: beyond, the model is continued; record the range that is used"
            )
    return told
