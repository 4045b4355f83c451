"""What each axis' predictor should know of the deviation, from the tracker's samples at rest.

A model is fitted to the first part of the samples (``deviation/fit.py``), and taken where the rest is likelier under it
than under what is said of all axes, by a margin; then it is fitted to all of them. A robot that stood still meanwhile
shows its noise and what its joints swing by, but no path: the jerk stays the one of all axes then.
"""

from __future__ import annotations

import numpy as np

from micromanip.control.joints import joints_radius
from micromanip.control.system import Array
from micromanip.errors import CheckFailed
from micromanip.settings.schema.reference import AxisDeviation, AxisTracker, Tracker

from ..identify.tracker.fit import Deviation, fit_deviation, followed
from ..identify.tracker.innovations import log_likelihood
from .quiescent_spectrum import AtRest

_FITTED, _MARGIN = 0.7, 5.0
"""Share of the samples that is fitted to; log-likelihood that the rest must gain."""
_MOVES, _SLOW_S = 20.0, 0.5
"""A robot is on its path where means over the one vary by so many times the noise."""


def known_deviations(common: Tracker, rest: AtRest) -> tuple[dict[str, AxisDeviation], tuple[str, ...]]:
    """Entries of ``reference.axes`` for the axes that are better off with one, and a sentence on each axis seen."""
    found: dict[str, AxisDeviation] = {}
    said = []
    for axis, samples in rest.deviation_um.items():
        try:
            found[axis], gained = _known(common, samples)
            sentence = (
                f"has its own {_told(found[axis])}: under them the samples held out are likelier, {gained:+.0f} in "
                "log-likelihood"
            )
        except CheckFailed as problem:
            sentence = f"keeps what is said of all axes ({problem})"
        said.append(f"The predictor of axis {axis} {sentence}.")
    return found, tuple(said)


def _known(common: Tracker, samples: Array) -> tuple[AxisDeviation, float]:
    """What `samples` (n,) show, and the log-likelihood gained; CheckFailed where they show nothing better."""
    count, rate_Hz = int(_FITTED * len(samples)), common.sample_rate_Hz
    held_out = samples[count:]
    early = _shown(common, fit_deviation(samples[:count], rate_Hz), samples[:count])
    gained = _likelihood(common, early, held_out) - _likelihood(common, AxisDeviation(), held_out)
    if gained < _MARGIN:
        raise CheckFailed(f"samples held out are no likelier under its own, {gained:+.1f} in log-likelihood")
    return _shown(common, fit_deviation(samples, rate_Hz), samples), gained


def _likelihood(common: Tracker, known: AxisDeviation, samples: Array) -> float:
    return log_likelihood(_tracker(common, known), samples)


def _tracker(common: Tracker, known: AxisDeviation) -> AxisTracker:
    return common.model_copy(update={"axes": {"": known}}).of("")


def _shown(common: Tracker, found: Deviation, samples: Array) -> AxisDeviation:
    """What `samples` (n,) can show: of a robot that stood still no jerk, and not that it has no oscillation."""
    settings, window = found.settings(), max(1, round(_SLOW_S * found.model.sample_rate_Hz))
    means = samples[: len(samples) // window * window].reshape(-1, window).mean(axis=1)
    if np.std(means) < _MOVES * found.model.noise_um:
        del settings["jerk_um_per_s3"]
        settings["oscillations"] = settings["oscillations"] or None
        if "steady" in settings:
            settings["steady"] = {}
    known = AxisDeviation.model_validate(settings)
    if known.jerk_um_per_s3 is None and known.oscillations is not None:
        # with the jerk of all axes it is another filter, which bears other ranges
        known = known.model_copy(update={"oscillations": followed(_tracker(common, known)).oscillations})
        sure = _tracker(common, known).sure
        if sure is not None and joints_radius(sure) >= 1.0:
            known = known.model_copy(update={"steady": None})
    return known


def _told(entry: AxisDeviation) -> str:
    told = [f"noise, {entry.noise_um:g} um"]
    if entry.jerk_um_per_s3 is not None:
        told.append(f"jerk {entry.jerk_um_per_s3:g} um/s^3")
    if entry.oscillations is not None:
        swinging = " and ".join(f"{each.frequency_Hz:g}" for each in entry.oscillations)
        told.append(f"oscillation at {swinging} Hz" if swinging else "no oscillation")
    return ", ".join(told)
