"""The update from part to part: mean of what would be there uncorrected, its inverse as a correction, and when not.

With the error e_k of part k, the correction c_k that was played in it, and the model T of its way to the stage, what
would have been there without it is ``e_k + T c_k``. Its mean over the parts is m, and

    c = Q W m / T,

Q a zero-phase low pass up to where T is known, W the confidence of each band (`spectrum.py`). As e_k = r - T_D c_k
with the true T_D and the share r that repeats, each update leaves of whatever c is wrong by at most

    max over frequencies and plants D of |Q W (1 - T_D / T)|

(iterative learning control with a mean over the iterations: Bristow, Tharayil, Alleyne, A Survey of Iterative Learning
Control, 2006; Saab, A Discrete-Time Stochastic Learning Control Algorithm, 2001). Only below 1 is it applied.

A part whose error, in the band that is learned, is larger than that of the part before beyond doubt goes back to what
was played before; if nothing was, all is forgotten. A part in which nothing was played though there was something to
play counts for the mean, and is compared with none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from micromanip.errors import CheckFailed

from .memory import Learned, Memory
from .part import Part
from .spectrum import Bands
from .zero_phase import answered, circulated, filtered, low_pass

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

BLOCKS = 16
"""Of a part, whose mean squares are compared one by one with those of the part before."""
_SURE = 0.995
_MOST_PARTS = 20
"""A part counts for 1 of so many at least, however many there were: what changes slowly is followed."""
_CORNER = 2.0 / 3.0
"""Of the highest frequency that is learned, where Q leaves one half."""
_TOLD = 50
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

    `interval_um` is where the rms of the error in band lies in 95 of 100 cases; `without_um` is what it would have been
    without the correction.
    """

    memory: Memory
    verdict: str
    forgotten: bool
    error_um: float
    without_um: float
    interval_um: tuple[float, float]


def updated(
    memory: Memory, part: Part, way: Way, limit_um: float, what: str, played_from_s: float = 0.0, *, own: bool = False
) -> Update:
    """The memory after `part` (of `what`, told in its story), in which a correction was played from `played_from_s` on.

    `own`: it is known to be of this memory, of an older state perhaps; then the part counts, and is compared with none.

    Raises CheckFailed where no update may be applied, and where the part is not of this memory: learned from before,
    or with another correction played.
    """
    bands = Bands(len(part.error_um), part.rate_hz, way.highest_Hz)
    if not bands.count:
        raise CheckFailed(
            f"axis {memory.axis}: its model is known to {way.highest_Hz:.3g} Hz, a part of {memory.seconds:g} s tells "
            "frequencies apart that far at best: nothing can be learned"
        )
    if memory.now.parts > 1 and len(memory.now.spread_um2) != bands.count:
        raise CheckFailed(
            f"axis {memory.axis}: its memory was made up to another frequency than the {way.highest_Hz:.3g} Hz to "
            "which its model is known: learn anew, after `micromanip learn reset`"
        )
    if any(told["part"] == part.name for told in memory.story):
        raise CheckFailed(f"{what}: axis {memory.axis} has learned from this part already")
    later = slice(round(played_from_s * part.rate_hz), None)
    played = _was_played(memory.now.correction_um[later], part.played_um[later], memory.axis, what, own)
    inside = filtered(part.error_um, part.rate_hz, partial(_low, way))
    blocks = np.array([np.mean(block**2) for block in np.array_split(inside, BLOCKS)])
    verdict = compared(memory.blocks_um2, blocks) if played else UNPLAYED
    forgotten = verdict == WORSE
    if forgotten:
        now, before = memory.before or Learned.nothing(len(part.error_um)), None
    else:
        now, before = _learned(memory, part, way, bands, limit_um), memory.now
    error_um, interval_um = _rms(blocks)
    told = {"file": what, "part": part.name, "generation": memory.generation, "verdict": verdict, "error_um": error_um,
            "error_least_um": interval_um[0], "error_most_um": interval_um[1],
            "missed_percent": 100.0 * part.missed}  # fmt: skip
    kept = replace(
        memory, now=now, before=before, blocks_um2=blocks if played else memory.blocks_um2,
        generation=memory.generation + 1, story=(*memory.story, told)[-_TOLD:],
    )  # fmt: skip
    without_um = float(np.sqrt(np.mean(filtered(_alone(memory, part, way), part.rate_hz, partial(_low, way)) ** 2)))
    return Update(kept, verdict, forgotten, error_um, without_um, interval_um)


def _was_played(correction_um: Array, played_um: Array, axis: str, what: str, own: bool) -> bool:
    """Whether the memory's correction was; True where it has none."""
    size, found = (float(np.sqrt(np.mean(each**2))) for each in (correction_um, played_um))
    apart = float(np.sqrt(np.mean((played_um - correction_um) ** 2)))
    if apart <= max(_NOTHING_UM, _AS_PLAYED * size):
        return True
    if own or found <= _NOTHING_UM:
        return False
    raise CheckFailed(
        f"{what}: a correction of {found:.3g} um rms was played to axis {axis}, {apart:.3g} um from the memory's: it "
        "is of another memory, or of an older state of this one"
    )


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


def _alone(memory: Memory, part: Part, way: Way) -> Array:
    """The error (n,) that would have been there without what was played; before a part with an end nothing was."""
    before_um = part.before_um if memory.repeats else part.before_um[:0]
    moved = answered(np.concatenate([before_um, part.played_um]), part.rate_hz, way.response)
    return part.error_um + moved[len(before_um) :]


def _low(way: Way, hertz: Array) -> Array:
    return low_pass(hertz, _CORNER * way.highest_Hz)


def _learned(memory: Memory, part: Part, way: Way, bands: Bands, limit_um: float) -> Learned:
    now, axis, alone = memory.now, memory.axis, _alone(memory, part, way)
    parts = min(now.parts + 1, _MOST_PARTS)
    mean = now.mean_um + (alone - now.mean_um) / parts
    # Welford's update of the variance, line by line
    if parts > 1:
        apart = np.sum((bands.spectrum(alone - now.mean_um) * np.conj(bands.spectrum(alone - mean))).real, axis=1)
        spread = now.spread_um2 + (apart - now.spread_um2) / (parts - 1)
    else:
        spread = np.zeros(bands.count)
    share = bands.confidence(bands.power(mean), spread, parts)
    left = contraction(way, bands, share)
    if not left < 1.0:
        raise CheckFailed(
            f"axis {axis}: the update would leave {left:.2f} of an error from part to part, on a plant that "
            "is not ruled out: not below 1, so it is not applied"
        )
    through = circulated if memory.repeats else filtered
    correction = through(mean, part.rate_hz, _played(way, bands, share))
    peak = float(np.abs(correction).max())
    if peak > limit_um:
        raise CheckFailed(
            f"axis {axis}: the correction would be {peak:.2f} um, at most {limit_um:g} um may be (--limit): not applied"
        )
    return Learned(parts, mean, spread, correction, left, bands.named(share))


def _played(way: Way, bands: Bands, share: Array) -> Callable[[Array], Complex]:
    """Q W / T, 0 where W is: T need not be known there."""

    def response(hertz: Array) -> Complex:
        gain = _low(way, hertz) * bands.gain(share, hertz)
        found = np.zeros(len(hertz), complex)
        found[gain > 0.0] = gain[gain > 0.0] / way.response(hertz[gain > 0.0])
        return found

    return response


def _rms(blocks_um2: Array) -> tuple[float, tuple[float, float]]:
    mean, error = float(np.mean(blocks_um2)), float(np.std(blocks_um2, ddof=1)) / np.sqrt(len(blocks_um2))
    beyond = float(student.ppf(0.975, len(blocks_um2) - 1)) * error
    return float(np.sqrt(mean)), (float(np.sqrt(max(0.0, mean - beyond))), float(np.sqrt(mean + beyond)))
