"""The update from part to part: mean of what would be there uncorrected, its inverse as a correction, and when not.

With the error e_k of part k, the correction c_k that was played in it, and the model T of its way to the stage, what
would have been there without it is ``e_k + T c_k``. Its mean over the parts is m, and

    c = Q W m / T,

Q a zero-phase low pass up to where T is known, W the confidence of each band (`spectrum.py`). As e_k = r - T_D c_k
with the true T_D and the share r that repeats, each update leaves of whatever c is wrong by at most

    max over frequencies and plants D of |Q W (1 - T_D / T)|

(iterative learning control with a mean over the iterations: Bristow, Tharayil, Alleyne, A Survey of Iterative Learning
Control, 2006; Saab, A Discrete-Time Stochastic Learning Control Algorithm, 2001). Only below 1 is it applied.

A part whose error, in the band that is learned, is larger than that of the part before beyond doubt ends what was
learned: learning begins anew. A part in which nothing was played though there was something to play counts for the
mean, and is compared with none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from micromanip.errors import CheckFailed

from .memory import Memory
from .part import Part
from .spectrum import Bands, answered, filtered, low_pass

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

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


class Way(Protocol):
    """From a correction to the stage: the model, and how far it may be off, at frequencies (n,) in Hz."""

    @property
    def highest_Hz(self) -> float: ...
    def response(self, hertz: Array) -> Complex: ...
    def off(self, hertz: Array) -> Array: ...


@dataclass(frozen=True)
class Update:
    """What became of a part: the memory after it, and how its error in band compares with that of the part before.

    `error_um` is the rms of the error in band, `without_um` what it would have been without the correction.
    """

    memory: Memory
    verdict: str
    error_um: float
    without_um: float


def updated(memory: Memory, part: Part, way: Way, limit_um: float) -> Update:
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


def contraction(way: Way, bands: Bands, share: Array) -> float:
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


def _low(way: Way, hertz: Array) -> Array:
    return low_pass(hertz, _CORNER * way.highest_Hz)


def _learned(memory: Memory, alone: Array, way: Way, bands: Bands, limit_um: float) -> Memory:
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
