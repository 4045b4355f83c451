"""The multisine that is injected into a running loop: its lines, its record for the loop, spectra of the response.

Lines lie on an FFT of one period, away from mains hum, closest where flexures have their modes. Above a corner
their amplitude falls with frequency: a set-point may move only so fast.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.rt.laws.excitation import MAX_LINES

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PERIOD_S, LEAD_S, FADE_S, PERIODS, LINES = 0.8, 0.6, 0.2, 5, 94
MISSED = 0.05
"""Share of the cycles that may be missed: on the simulated cell, stalled like a busy machine, the stated confidence
holds Ms up to it; above, the loop that is measured is not the loop that was designed."""
LOW_HZ, WIDE_SHARE, WIDEST_HZ = 10.0, 0.35, 3000.0
_CORNER_HZ, _MAINS_HZ, _TRIALS = 300.0, (50.0, 60.0), 20
_MODES_HZ, _SHARES = (35.0, 180.0), (0.1, 0.6)
"""Half of the lines lie in this band, a tenth below."""


@dataclass(frozen=True)
class Injection:
    """What is played: at line `harmonic` (k,) of `period_cycles`, `amplitude` (k,) in um, and `phase` (k,)."""

    harmonic: NDArray[np.int64]
    amplitude: Array
    phase: Array
    period_cycles: int
    fade_cycles: int
    lead_cycles: int
    rate_hz: float

    @property
    def frequency_Hz(self) -> Array:
        """Frequencies (k,) of the lines."""
        return np.asarray(self.harmonic * (self.rate_hz / self.period_cycles))

    @property
    def first_cycle(self) -> int:
        """Cycles after the beginning at which the first whole period begins."""
        return self.fade_cycles + self.lead_cycles

    @property
    def cycles(self) -> int:
        """Length, both fades included."""
        return self.first_cycle + PERIODS * self.period_cycles + self.fade_cycles

    @property
    def course(self) -> Array:
        """One period of it (period_cycles,), um."""
        spectrum = np.zeros(self.period_cycles // 2 + 1, complex)
        spectrum[self.harmonic] = 0.5 * self.period_cycles * self.amplitude * np.exp(1j * self.phase)
        return np.asarray(np.fft.irfft(spectrum, self.period_cycles))

    @property
    def peak(self) -> float:
        """Largest value, um."""
        return float(np.abs(self.course).max())

    @property
    def fastest(self) -> float:
        """Largest change within a cycle, um."""
        course = self.course
        return float(np.abs(np.diff(course, append=course[0])).max())

    def fill(self, record: Any, number: int, *, stop: bool = False) -> None:
        """Write it into the loop's record EXCITATION_PARAMETERS."""
        count = len(self.harmonic)
        record["number"], record["stop"], record["cycles"] = number, int(stop), self.cycles
        record["fade_cycles"], record["period_cycles"], record["lines"] = self.fade_cycles, self.period_cycles, count
        record["harmonic"][:count], record["amplitude"][:count] = self.harmonic, self.amplitude
        record["phase"][:count] = self.phase

    def spectra(self, cycle: NDArray[np.int64], signals: Array) -> Complex:
        """Lines (2, windows, k) of what goes into a plant and what comes out, `signals` (n, 2).

        They were taken `cycle` (n,) cycles after its beginning. Windows of Hann over two periods, half of each in the
        next: what else moves meanwhile, a reference of a hundred times the size, doesn't leak into lines far from it.
        Where cycles are missing, the input stood still as the hardware did, and the output went straight. Raises
        ValueError where the whole periods are not covered, or more than MISSED of them is missing.
        """
        wanted = self.first_cycle + np.arange(PERIODS * self.period_cycles)
        if len(cycle) == 0 or cycle[0] > wanted[0] or cycle[-1] < wanted[-1]:
            raise ValueError("the record does not cover the whole periods")
        missed = 1.0 - np.count_nonzero(np.isin(wanted, cycle)) / len(wanted)
        if missed > MISSED:
            raise ValueError(
                f"{100 * missed:.1f} % of the cycles were missed, at most {100 * MISSED:g} % may be: "
                "`micromanip system check` says what disturbs the loop"
            )
        held = signals[np.searchsorted(cycle, wanted, side="right") - 1, 0]
        kept = np.column_stack([held, np.interp(wanted, cycle, signals[:, 1])])
        width = 2 * self.period_cycles
        window = (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(width) / width))[:, None]
        firsts = range(0, len(kept) - width + 1, self.period_cycles)
        pieces = np.stack([kept[first : first + width] for first in firsts])
        pieces = window * (pieces - pieces.mean(axis=1, keepdims=True))
        return np.asarray(np.moveaxis(np.fft.rfft(pieces, axis=1)[:, 2 * self.harmonic], -1, 0))


def highest_Hz(rate_hz: float, trusted_Hz: float = np.inf) -> float:
    """Highest line of a loop at `rate_hz`, whose samples are right up to `trusted_Hz`."""
    return min(WIDE_SHARE * rate_hz, WIDEST_HZ, trusted_Hz)


def injection(
    rms_um: float,
    high_Hz: float,
    rate_hz: float,
    *,
    seed: int,
    lines: int = LINES,
    suppressed: Callable[[Array], Array] = np.ones_like,
) -> Injection:
    """An injection that arrives with `rms_um`, up to `high_Hz`, of some `lines` lines; phases by the crest.

    `suppressed` says of frequencies (k,) how much less of a line arrives, because a loop takes it away: so much more of
    it is played.
    """
    period = round(PERIOD_S * rate_hz)
    step_Hz = rate_hz / period
    # over the band of a flexure's modes so close that none hides between two lines
    edges = np.minimum([LOW_HZ, *_MODES_HZ, high_Hz], high_Hz)
    place = np.interp(np.linspace(0.0, 1.0, lines), [0.0, *_SHARES, 1.0], np.log(edges))
    on_grid = np.unique(np.round(np.exp(place) / step_Hz)).astype(np.int64)
    hertz = on_grid * step_Hz
    hum = np.min([np.abs(hertz / mains - np.round(hertz / mains)) * mains for mains in _MAINS_HZ], axis=0)
    chosen = on_grid[hum > 0.6 * step_Hz][:MAX_LINES]
    shape = 1.0 / np.maximum(1.0, chosen * step_Hz / _CORNER_HZ)
    amplitude = rms_um * np.sqrt(2.0 / np.sum(shape**2)) * shape * suppressed(chosen * step_Hz)
    rng, best = np.random.default_rng(seed), None
    for _ in range(_TRIALS):
        phase = rng.uniform(0.0, 2.0 * np.pi, len(chosen))
        tried = Injection(chosen, amplitude, phase, period, round(FADE_S * rate_hz), round(LEAD_S * rate_hz), rate_hz)
        if best is None or tried.peak < best.peak:
            best = tried
    assert best is not None
    return best
