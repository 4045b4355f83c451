"""Coupling of the axes, measured: each in turn is moved, with all strain loops closed, and every sensor is looked at.

    C_ij = Y_i / Y_j     while axis j alone is moved,

so that the plant of all outer loops is ``C diag(G_jj)`` with the stages' own responses G_jj. Hysteresis and creep of
the axis that is moved are in both Y, and so are not in C. The standard deviation is that of what differs from period to
period (``response/measured.py``); at rest it is that of the mean over the lowest lines, or their scatter if more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.settings.schema.model import Configuration

from ...experiment import Experiment, parked, path_bandwidth, play, with_axes, within_slew
from ...identify.response import Measured, Multisine, measure, multisine

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

AT_REST_HZ = 5.0
"""Up to here a stage answers as at rest."""
_RMS_UM = ((5.0, 1.5), (30.0, 1.0), (150.0, 0.7), (300.0, 1.0))
"""Upper frequency and rms of each part of the set-point's excitation; above, the outer loops have no gain left."""
_LOW_HZ, _LEAD_S, _SLEW_SHARE = 0.3, 1.0, 0.7
_LEAST = 1e-6
"""Standard deviation below which none is believed."""
_SURE = 3.0
"""Standard deviations beyond which a share is one."""
_SURE_OF_MANY = 5.0
"""The same where hundreds of lines are looked at: one of them is always far out."""


@dataclass(frozen=True)
class Coupling:
    """C and its standard deviation, (n, n, k) at the frequencies (k,); row i sees, column j moves; 1 on the diagonal.

    `rest` (n, n) and its deviation are those at rest, `gauge` and its deviation the same of the strain gauges.
    """

    axes: tuple[str, ...]
    frequency_Hz: Array
    share: Complex
    deviation: Array
    rest: Array
    rest_deviation: Array
    gauge: Array
    gauge_deviation: Array

    @property
    def sure(self) -> NDArray[np.bool_]:
        """Which shares at rest (n, n) are beyond their uncertainty; none of the diagonal."""
        return np.asarray((np.abs(self.rest) > _SURE * self.rest_deviation) & ~np.eye(len(self.axes), dtype=bool))

    @property
    def sure_size(self) -> Array:
        """|C| (n, n, k) where it is beyond its uncertainty, else 0."""
        size = np.abs(self.share)
        return np.asarray(np.where(size > _SURE_OF_MANY * self.deviation, size, 0.0))

    @property
    def largest(self) -> tuple[float, float, str, str]:
        """The largest |C_ij| over frequency: its size, where (Hz), the axis that sees it, and the one that moves."""
        size = self.sure_size.copy()
        size[range(len(self.axes)), range(len(self.axes))] = 0.0
        i, j, k = np.unravel_index(int(np.argmax(size)), size.shape)
        return float(size[i, j, k]), float(self.frequency_Hz[k]), self.axes[i], self.axes[j]


def measure_coupling(
    configuration: Configuration, experiment: Experiment, seed: int, say: Callable[[str], None] = lambda _: None
) -> Coupling:
    """Move each axis of `configuration`, all of which are tuned; the others are held at their working points.

    Raises CheckFailed where a sensor has gaps.
    """
    names, rate_hz = tuple(configuration.axes), float(configuration.loop.rate_hz)
    band = min(path_bandwidth(experiment.path(configuration, name), configuration.loop.rate_hz) for name in names)
    cutoff_Hz = min(_RMS_UM[-1][0], 0.4 * rate_hz, band)
    held = with_axes(configuration, mode="strain", actuator=None)
    seen: list[tuple[list[Measured], list[Measured]]] = []
    for j, name in enumerate(names):
        say(f"axis {name} moves, the others are held")
        wave = multisine(_RMS_UM, _LOW_HZ, cutoff_Hz, rate_hz, seed=seed + j, lead_s=_LEAD_S, periods=3, draws=1)
        seen.append(_moved(held, experiment, j, wave))
    return assembled(names, [stages for stages, _ in seen], [gauges for _, gauges in seen])


def _moved(
    held: Configuration, experiment: Experiment, j: int, wave: Multisine
) -> tuple[list[Measured], list[Measured]]:
    """Each stage, and each gauge, in terms of that of axis number `j`, which is moved."""
    axes = list(held.axes.values())
    samples = parked(held, len(wave.samples))
    samples[:, : len(axes)] = [axis.centre_um for axis in axes]
    samples[:, j] += within_slew(held, list(held.axes)[j], wave.samples, _SLEW_SHARE)
    rows = play(held, experiment, samples)
    found = []
    for role in ("stage_um", "strain_um"):
        moved = np.asarray(rows[role][:, : len(axes)], dtype=float)
        if not np.isfinite(moved).all():
            gone = list(held.axes)[int(np.argmin(np.isfinite(moved).all(axis=0)))]
            raise CheckFailed(f"axis {gone}: {role} has gaps in the record of the coupling; look at its cable")
        found.append([_itself(wave) if i == j else measure(wave, moved[:, j], moved[:, i]) for i in range(len(axes))])
    return found[0], found[1]


def _itself(wave: Multisine) -> Measured:
    """What an axis sees of itself: all, for sure."""
    ones, none = np.ones(len(wave.lines)), np.zeros(len(wave.lines))
    return Measured(wave.frequency_Hz, ones.astype(complex), ones.astype(complex)[None], none, none)


def assembled(axes: tuple[str, ...], stages: list[list[Measured]], gauges: list[list[Measured]]) -> Coupling:
    """The whole of it, of what was seen by each axis, [moved][seen]."""
    hertz = stages[0][0].frequency_Hz
    share, deviation = (
        np.array([[getattr(column[i], name) for column in stages] for i in range(len(axes))])
        for name in ("response", "deviation")
    )
    rest, gauge = (
        np.array([[at_rest(column[i]) for column in seen] for i in range(len(axes))]) for seen in (stages, gauges)
    )
    return Coupling(axes, hertz, share, deviation, rest[..., 0], rest[..., 1], gauge[..., 0], gauge[..., 1])


def at_rest(measured: Measured) -> tuple[float, float]:
    """Real part at rest, and its standard deviation: of the lines up to ``AT_REST_HZ``, each as much as it is sure."""
    low = measured.frequency_Hz <= AT_REST_HZ
    if not low.any():
        raise CheckFailed(f"nothing was measured below {AT_REST_HZ:g} Hz: the coupling at rest is not known")
    values, deviation = measured.response.real[low], np.maximum(measured.deviation[low], _LEAST)
    weight = deviation**-2.0
    mean = float(np.sum(weight * values) / np.sum(weight))
    scatter = float(np.sqrt(np.sum(weight * (values - mean) ** 2) / np.sum(weight) / max(len(values) - 1, 1)))
    return mean, max(float(np.sum(weight) ** -0.5), scatter)
