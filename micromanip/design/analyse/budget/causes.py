"""What each cause does to the path error of an axis: its power over frequency, from spectra through the closed loop.

The variance of a cause is that of its own spectrum behind its transfer (Wiener-Khinchin; the same as the stationary
covariance of the loop's states, which the tests compute by a discrete Lyapunov equation). All are kept as power (um^2)
in narrow bins of frequency: sums over bins are variances, sums over causes the whole.

What answers to the same sines of the path, prediction, misfit of the model and creep, is not independent: the power
that these make together is shared out in proportion to what each makes alone, so that none is negative and the sum is
right.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from micromanip.bus.simulated_axis import Line, SimulatedAxis

from .loop import AxisLaws, Loop
from .tracking import Tracking

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

TRACKER, PREDICTION, FORCE, STAGE, STRAIN, AMPLIFIER, COUPLING, CREEP, MISFIT, NUMERICS = (
    "tracker noise",
    "tracker delay, rate, prediction",
    "force",
    "capacitive sensor noise",
    "strain gauge noise",
    "amplifier noise",
    "coupling",
    "creep",
    "model mismatch",
    "quantisation",
)
BIN_HZ = 0.5
"""Narrow beside the lightest mode; finer changes nothing."""


@dataclass(frozen=True)
class Grid:
    """Bins of frequency from 0 to half of the loop's rate; `hertz` (n,) are their middles."""

    rate_hz: float
    bin_hz: float = BIN_HZ

    @cached_property
    def hertz(self) -> Array:
        """Middles of the bins."""
        count = round(0.5 * self.rate_hz / self.bin_hz)
        return np.asarray((np.arange(count) + 0.5) * self.bin_hz)

    @cached_property
    def omega(self) -> Array:
        """The same in rad/s."""
        return np.asarray(2.0 * np.pi * self.hertz)

    def white(self, transfer: Complex, variance: float) -> Array:
        """Power (n,) behind `transfer` (n,) of noise that is white from cycle to cycle."""
        return np.asarray(np.abs(transfer) ** 2 * (variance / len(self.hertz)))

    def place(self, hertz: Array) -> NDArray[np.int64]:
        """Bin (k,) of each of the frequencies `hertz` (k,), negative ones at their positive ones."""
        return np.asarray(np.minimum((np.abs(hertz) / self.bin_hz).astype(int), len(self.hertz) - 1))

    def lines(self, hertz: Array, power: Array) -> Array:
        """`power` (k,) of sines of `hertz` (k,) in their bins."""
        return np.asarray(np.bincount(self.place(hertz), weights=power, minlength=len(self.hertz)), dtype=float)


Powers = dict[str, Array]
"""Power (n,) in um^2 of each cause by name."""


def shared_out(whole: Array, alone: Mapping[str, Array]) -> Powers:
    """`whole` (n,) divided in proportion to what each makes `alone` (n,); where that is nothing, in equal parts.

    Every share is at least 0, and their sum is `whole`, which must not be negative.
    """
    total = np.sum(list(alone.values()), axis=0)
    some = total > 0.0
    return {
        name: whole * np.where(some, np.divide(power, total, where=some, out=np.zeros_like(total)), 1.0 / len(alone))
        for name, power in alone.items()
    }


def tracker_noise(grid: Grid, loop: Loop, tracking: Tracking, taken: Array, noise_um: float) -> Array:
    """Power (n,) of the tracker's noise."""
    transfer = loop.followed * tracking.response(taken, grid.omega)
    return grid.white(transfer, noise_um**2 / tracking.every)


def followed_share(loop: Loop, tracking: Tracking, taken: Array) -> Complex:
    """What the stage does (n,) of a sine of the deviation of amplitude 1, at the frequencies of `loop`."""
    late = np.exp(-1j * loop.omega * tracking.latency_s)
    return np.asarray(loop.followed * tracking.response(taken, loop.omega) * late / tracking.every)


def followed_line(loop: Loop, tracking: Tracking, taken: Array, hertz: float) -> Complex:
    """Error (k,) at the images of a sine of the deviation of amplitude 1 at `hertz`; `loop` is that of those images."""
    late = np.exp(-2j * np.pi * hertz * tracking.latency_s)
    followed = loop.followed * tracking.response(taken, loop.omega) * late / tracking.every
    wanted = np.zeros(len(followed))
    wanted[0] = 1.0
    return np.asarray(wanted - followed)


def path_powers(
    grid: Grid, laws: AxisLaws, tracking: Tracking, deviation: Iterable[Line], known: SimulatedAxis | None
) -> Powers:
    """Power of what answers to the path: prediction; misfit of the model and creep where the plant is `known`."""
    taken = laws.gains.reference
    powers = dict.fromkeys((PREDICTION, *(() if known is None else (MISFIT, CREEP))), np.zeros(len(grid.hertz)))
    for hertz, um in deviation:
        at = tracking.images(hertz)
        omega = 2.0 * np.pi * at
        plants = [laws.model(omega)]
        if known is not None:
            plants += [laws.simulated(plant, omega)[0] for plant in (known.plant, known.crept)]
        errors = [followed_line(laws.around(plant, omega), tracking, taken, hertz) for plant in plants]
        parts = [errors[0], *(later - before for before, later in pairwise(errors))]
        alone = {name: np.abs(part) ** 2 for name, part in zip(powers, parts, strict=True)}
        shares = shared_out(0.5 * um**2 * np.abs(errors[-1]) ** 2, alone)
        powers = {name: power + grid.lines(at, shares[name]) for name, power in powers.items()}
    return powers


def force_power(grid: Grid, laws: AxisLaws, known: SimulatedAxis, loop: Loop, to_stage: Complex) -> Array:
    """Power (n,) of the force, once the tool is in: first-order noise and its sine at tooth passing.

    `to_stage` (n,) is um per N. The steady part is none of it: the outer loop takes it away.
    """
    rms_N, bandwidth_Hz = known.force_noise
    kept = np.exp(-laws.period_s * 2.0 * np.pi * bandwidth_Hz)
    coloured = 1.0 / (1.0 - kept * np.exp(-1j * grid.omega * laws.period_s))
    power = grid.white(loop.sensitivity * to_stage * coloured, rms_N**2 * (1.0 - kept * kept))
    return np.asarray(power + _disturbed(grid, laws, known, (known.tooth,), of_force=True))


def _disturbed(grid: Grid, laws: AxisLaws, known: SimulatedAxis, lines: tuple[Line, ...], *, of_force: bool) -> Array:
    """Power of sines of the stage's position (um), or of the force on it (N)."""
    hertz, amplitudes = np.array(lines).T
    omega = 2.0 * np.pi * hertz
    plant, to_stage = laws.simulated(known.crept, omega)
    moved = laws.around(plant, omega).sensitivity * (to_stage if of_force else 1.0)
    return grid.lines(hertz, 0.5 * (amplitudes * np.abs(moved)) ** 2)


def simulated_powers(grid: Grid, laws: AxisLaws, tracking: Tracking, known: SimulatedAxis) -> Powers:
    """Power of every cause that a linear model shows of a simulated axis."""
    plant, to_stage = laws.simulated(known.crept, grid.omega)
    loop, taken = laws.around(plant, grid.omega), laws.gains.reference
    of_strain, of_voltage = loop.of_setpoint * loop.per_strain, loop.of_setpoint * loop.per_voltage
    hum_Hz, hum_um = known.hum
    at_hum = grid.place(np.array([hum_Hz]))
    hum = grid.lines(np.array([hum_Hz]), 0.5 * (hum_um * np.abs(of_strain[at_hum])) ** 2)
    steps = grid.white(of_strain, known.strain_step_um**2 / 12.0) + grid.white(of_voltage, known.voltage_step_V**2 / 12)
    return {
        TRACKER: tracker_noise(grid, loop, tracking, taken, known.tracker_noise_um),
        **path_powers(grid, laws, tracking, known.deviation, known),
        FORCE: force_power(grid, laws, known, loop, to_stage),
        STAGE: grid.white(loop.of_stage_noise, known.stage_noise_um**2),
        STRAIN: grid.white(of_strain, known.strain_noise_um**2) + hum,
        AMPLIFIER: grid.white(of_voltage, known.amplifier_noise_V**2),
        COUPLING: _disturbed(grid, laws, known, known.neighbours, of_force=False) if known.neighbours else 0.0 * steps,
        NUMERICS: steps,
    }
