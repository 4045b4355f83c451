"""What the sensors of an axis say while nothing moves: before any voltage, and long before any loop is closed.

A gauge that is dead, flagged or on its rail would let a strain loop run away. The capacitive sensor may be at the end
of its range where the stage rests: ``travel.py`` judges it, still in open loop.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker

from ..experiment import Experiment, parked
from ..identification import variant

Array = NDArray[np.float64]

REST_S = 0.3
_PRESENT, _NOISY = 0.5, 0.02
"""Share of the expected samples that must come; noise at rest, as a share of the set-point's range."""
_FRESH = {"strain": ("strain gauge", 1), "deviation": ("tracker", 4)}


def check_rest(configuration: Configuration, experiment: Experiment, axis: str) -> None:
    """Look at the sensors of `axis` with every output parked; raises CheckFailed where one can't be trusted."""
    rows = experiment(variant(configuration), REST_S, parked(configuration, round(REST_S * configuration.loop.rate_hz)))
    of_axis = rows["axis"][:, list(configuration.axes).index(axis)]
    path, tracked = experiment.path(configuration, axis), isinstance(configuration.reference, Tracker)
    expected = {"strain": len(rows) / max(path.strain_cycles, 1), "deviation": 2.0}
    for role in ("strain", "deviation") if tracked else ("strain",):
        _require_samples(axis, role, of_axis, expected[role])
    strain = _fresh(of_axis, "strain")
    signal = configuration.signals[f"strain_{axis}"]
    at_end = signal.range_um is not None and strain[0] in signal.range_um
    if np.ptp(strain) == 0.0 and (at_end or configuration.faults.axis.strain.identical is not None):
        raise CheckFailed(
            f"axis {axis}: at rest the strain gauge reads exactly {strain[0]:g} um all the time, without any "
            f"noise{', an end of its range' if at_end else ''}: it is dead, not connected or on its rail; check its "
            f"supply, cable and zero, and signals.strain_{axis}. Where it is merely coarser than its noise, "
            "faults.axis.strain.identical: null says so. Nothing was moved or closed"
        )
    low, high = configuration.axes[axis].setpoint.range_um
    noise_um = float(strain.std())
    if noise_um > _NOISY * (high - low):
        raise CheckFailed(
            f"axis {axis}: at rest the strain gauge moves by {noise_um:.2g} um rms, more than {100 * _NOISY:g} % of "
            "the set-point's range: an open input or a disturbance; check its cable and shield. Nothing was moved "
            "or closed"
        )


def _fresh(of_axis: NDArray[Any], role: str) -> Array:
    return np.asarray(of_axis[f"{role}_um"][(of_axis["fresh"] & _FRESH[role][1]) != 0], dtype=float)


def _require_samples(axis: str, role: str, of_axis: NDArray[Any], expected: float) -> None:
    came = len(_fresh(of_axis, role))
    if came < _PRESENT * expected:
        raise CheckFailed(
            f"axis {axis}: the {_FRESH[role][0]} gives {came or 'no'} usable samples in {REST_S:g} s "
            "at rest: none come, or they are late, no numbers, flagged as invalid, or outside range_um of "
            f"signals.{role}_{axis}; `micromanip device probe CONFIG` shows what it says. Nothing was moved or closed"
        )
