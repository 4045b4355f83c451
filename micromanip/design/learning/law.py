"""The update from part to part: mean of what would be there uncorrected, its inverse as a correction, and when not.

With the error e_k of part k, the correction c_k that was played in it, and the model T of its way to the stage, what
would have been there without it is ``e_k + T c_k``. Its mean over the parts is m, and

    c = Q W m / T,

Q a zero-phase low pass up to where T is known, W the confidence of each band (`part.py`). As e_k = r - T_D c_k
with the true T_D and the share r that repeats, each update leaves of whatever c is wrong by at most

    max over frequencies and plants D of |Q W (1 - T_D / T)|

(iterative learning control with a mean over the iterations: Bristow, Tharayil, Alleyne, A Survey of Iterative Learning
Control, 2006; Saab, A Discrete-Time Stochastic Learning Control Algorithm, 2001). Only below 1 is it applied.

A part whose error, in the band that is learned, is larger than that of the part before beyond doubt ends what was
learned: learning begins anew. A part in which nothing was played though there was something to play counts for the
mean, and is compared with none.

From a correction of the reference to the stage: the laws as they run around the model, and around other plants.

The correction c comes with its first and second difference, of which the outer loop takes ``G_0 + G_1 s + G_2 s^2``
(`control/outer_gains.py`), so that with R, Y and the plant G of `budget/loop.py`

    T = G R / (1 + G Y) (G_0 + j G_1 sin(w h) / h - 2 G_2 (1 - cos(w h)) / h^2).

It is 1 where the loop follows. How wrong it may be is ``off = max |1 - T_D / T|`` over plants D drawn as robustness is
judged for (`analyse/loops.py::SPREAD`): mass, stiffness, damping and delay of the stage.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.stats import t as student

from micromanip.control.system import Array, Complex, System
from micromanip.design.analyse.loops import drawn_plant
from micromanip.errors import CheckFailed
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker

from ..analyse.budget.loop import AxisLaws
from ..analyse.loops import draw
from .memory import Memory
from .part import Bands, Part, answered, filtered, low_pass

DRAWS = 40
MOST_OFF = 0.2
"""Up to where the transfer is this well known at least, something is learned."""
_GRID_HZ = np.concatenate([np.array([0.05, 0.2, 0.5]), np.arange(1.0, 201.0)])


@dataclass(frozen=True)
class Transfer:
    """Correction to stage, um per um, of the axis with `laws`."""

    laws: AxisLaws
    draws: int = DRAWS

    def response(self, hertz: Array) -> Complex:
        """T (n,) with the configured model."""
        omega = np.asarray(2.0 * np.pi * hertz)
        return self._around(self.laws.model(omega), omega)

    def off(self, hertz: Array) -> Array:
        """How far T may be off (n,), by linear interpolation; what is beyond 200 Hz is not known."""
        return np.asarray(np.interp(hertz, _GRID_HZ, self._off, right=np.inf))

    @cached_property
    def highest_Hz(self) -> float:
        """Up to where T is known to `MOST_OFF`; 0 where it is nowhere."""
        wrong = np.flatnonzero(self._off > MOST_OFF)
        return float(_GRID_HZ[-1] if not len(wrong) else _GRID_HZ[wrong[0] - 1] if wrong[0] else 0.0)

    @cached_property
    def _off(self) -> Array:
        omega = 2.0 * np.pi * _GRID_HZ
        nominal = self._around(self.laws.model(omega), omega)
        return np.asarray(
            np.max(
                [abs(1.0 - self._around(plant.response(omega), omega) / nominal) for plant in self._plants()], axis=0
            )
        )

    def _plants(self) -> list[System]:
        outer = self.laws.axis.outer
        assert outer is not None
        drawn = [drawn_plant(draw(seed), None, outer.model, self.laws.period_s) for seed in range(self.draws)]
        return [plant for plant in drawn if plant is not None]

    def _around(self, plant: Complex, omega: Array) -> Complex:
        h, row = self.laws.period_s, self.laws.gains.reference
        taken = row[0] + 1j * row[1] * np.sin(omega * h) / h - 2.0 * row[2] * (1.0 - np.cos(omega * h)) / h**2
        return np.asarray(self.laws.around(plant, omega).followed * taken)


def way_of(configuration: Configuration, name: str) -> Transfer:
    """From a correction to the stage of axis `name`. CheckFailed where its laws don't allow of one."""
    tracker, axis = configuration.reference, configuration.axes[name]
    if not isinstance(tracker, Tracker):
        raise CheckFailed(
            f"only what follows a tracker learns: reference.source is {tracker.source}, it must be signal"
        )
    if axis.authority_percent != 100.0:
        raise CheckFailed(f"axis {name}: authority_percent is {axis.authority_percent:g}: it learns with 100 only")
    return Transfer(AxisLaws(name, axis, tracker.of(name), configuration.loop.period_ns * 1e-9))


BLOCKS = 16
"""Of a part, whose mean squares are compared one by one with those of the part before."""
_SURE = 0.995
_MOST_PARTS = 20
"""A part counts for 1 of so many at least, however many there were: what changes slowly is followed."""
_CORNER = 2.0 / 3.0
"""Of the highest frequency that is learned, where Q leaves one half."""
WORSE, BETTER, ALIKE, FIRST, UNPLAYED = "worse", "better", "no difference", "first", "not played"
_NOTHING_UM, _AS_PLAYED = 0.01, 0.25
"""Rms of a recorded correction that is none; by how much of itself it may be another than the memory's."""
_STEP_HZ = 0.25


@dataclass(frozen=True)
class Update:
    """What became of a part: the memory after it, and how its error in band compares with that of the part before.

    `error_um` is the rms of the error in band, `without_um` what it would have been without the correction.
    """

    memory: Memory
    verdict: str
    error_um: float
    without_um: float


def updated(memory: Memory, part: Part, way: Transfer, limit_um: float) -> Update:
    """The memory after `part`. Raises CheckFailed where no update may be applied."""
    bands = Bands(len(part.error_um), part.rate_hz, way.highest_Hz)
    if not bands.count:
        raise CheckFailed(f"the axis' model is known to {way.highest_Hz:.3g} Hz: too little to learn from such a part")
    if len(memory.spread_um2) not in (0, bands.count):
        raise CheckFailed("its memory was made up to another frequency: learn anew, after `micromanip learn reset`")
    alone = part.error_um + answered(part.played_um, part.rate_hz, way.response)
    error, without = (filtered(each, part.rate_hz, partial(_low, way)) for each in (part.error_um, alone))
    blocks = np.array([np.mean(block**2) for block in np.array_split(error, BLOCKS)])
    verdict = compared(memory.blocks_um2, blocks) if _was_played(memory, part) else UNPLAYED
    if verdict == WORSE:
        kept = memory.forgotten()
    else:
        kept = _learned(memory, alone, way, bands, limit_um)
        kept = replace(kept, blocks_um2=memory.blocks_um2 if verdict == UNPLAYED else blocks)
    kept = replace(kept, generation=memory.generation + 1)
    return Update(kept, verdict, float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(without**2))))


def compared(before_um2: Array, blocks_um2: Array) -> str:
    """How mean squares (blocks,) of an error compare with those of the part before, block by block (Student's t)."""
    if len(before_um2) != len(blocks_um2):
        return FIRST
    more = blocks_um2 - before_um2
    error = float(np.std(more, ddof=1)) / np.sqrt(len(more))
    beyond = float(student.ppf(_SURE, len(more) - 1)) * error
    mean = float(np.mean(more))
    return WORSE if mean > beyond else BETTER if mean < -beyond else ALIKE


def contraction(way: Transfer, bands: Bands, share: Array) -> float:
    """What one update leaves at most of whatever is wrong in the correction, with `share` (bands,) for W."""
    steps = np.arange(1, round(bands.count * bands.width_hz / _STEP_HZ))
    hertz = np.asarray(steps * _STEP_HZ, dtype=np.float64)
    gain = _low(way, hertz) * bands.gain(share, hertz)
    return float(np.max(gain * way.off(hertz), initial=0.0))


def _was_played(memory: Memory, part: Part) -> bool:
    """Whether the memory's correction was; True where it has none."""
    size = float(np.sqrt(np.mean(memory.correction_um**2)))
    apart = float(np.sqrt(np.mean((part.played_um - memory.correction_um) ** 2)))
    return apart <= max(_NOTHING_UM, _AS_PLAYED * size)


def _low(way: Transfer, hertz: Array) -> Array:
    return low_pass(hertz, _CORNER * way.highest_Hz)


def _learned(memory: Memory, alone: Array, way: Transfer, bands: Bands, limit_um: float) -> Memory:
    parts = min(memory.parts + 1, _MOST_PARTS)
    mean = memory.mean_um + (alone - memory.mean_um) / parts
    spread = np.zeros(bands.count)
    if parts > 1:  # Welford's update of the variance, line by line
        apart = np.sum((bands.spectrum(alone - memory.mean_um) * np.conj(bands.spectrum(alone - mean))).real, axis=1)
        spread = memory.spread_um2 + (apart - memory.spread_um2) / (parts - 1)
    share = bands.confidence(bands.power(mean), spread, parts)
    left = contraction(way, bands, share)
    if not left < 1.0:
        raise CheckFailed(
            f"the update would leave {left:.2f} of an error from part to part, on a plant that is not ruled out: not "
            "below 1, so it is not applied"
        )

    def inverse(hertz: Array) -> Complex:
        """Q W / T, 0 where W is: T need not be known there."""
        gain = _low(way, hertz) * bands.gain(share, hertz)
        found = np.zeros(len(hertz), complex)
        found[gain > 0.0] = gain[gain > 0.0] / way.response(hertz[gain > 0.0])
        return found

    correction = filtered(mean, memory.rate_hz, inverse)
    peak = float(np.abs(correction).max())
    if peak > limit_um:
        raise CheckFailed(f"the correction would be {peak:.2f} um, learning.limit_um is {limit_um:g}: not applied")
    return replace(
        memory, parts=parts, mean_um=mean, spread_um2=spread, correction_um=correction, contraction=left,
        learned_Hz=bands.named(share),
    )  # fmt: skip
