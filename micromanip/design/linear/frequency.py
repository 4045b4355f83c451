"""Frequency response measured from recordings, with its coherence: H1 estimate by Welch's method.

``H(f) = S_yu S_uu^-1`` from cross spectra averaged over overlapping windowed segments. The multiple coherence
``S_yu S_uu^-1 S_uy / S_yy`` is the share of an output's power that the inputs explain linearly: 1 without noise and
nonlinearity; where it is low, the response means nothing. Bendat and Piersol, Random Data, chapters 6 and 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import get_window

from .modal import Array, Complex
from .subspace import Experiment

_AVERAGES = 8
"""Segments wanted for each input: with as many as there are inputs the coherence would be 1 whatever the data."""
_LONGEST = 1 << 14


@dataclass(frozen=True)
class FrequencyResponse:
    """At frequencies (f,) in Hz the response (f, outputs, inputs) and the coherence (f, outputs), 0 .. 1.

    `explained` (outputs,) is the coherence over all frequencies: the share of the output's whole power.
    """

    frequency_Hz: Array
    response: Complex
    coherence: Array
    explained: Array
    averages: int


def frequency_response(experiments: Sequence[Experiment], dt: float, segment: int | None = None) -> FrequencyResponse:
    """Response of ``y`` (n, outputs) to ``u`` (n, inputs), all experiments averaged; Hann window, half overlapped.

    The resolution is ``1 / (segment dt)``; `segment` (samples) is by default the largest power of 2 that leaves 8
    averages an input. Raises ValueError where not even two segments an input fit in.
    """
    inputs, outputs = experiments[0][0].shape[1], experiments[0][1].shape[1]
    if segment is None:
        segment = _LONGEST
        while segment > 16 and _count(experiments, segment) < _AVERAGES * inputs:
            segment //= 2
    averages = _count(experiments, segment)
    if averages < 2 * inputs:
        raise ValueError(f"{averages} segments of {segment} samples are too few for {inputs} inputs: record longer")
    window = get_window("hann", segment)
    bins = segment // 2 + 1
    s_uu = np.zeros((bins, inputs, inputs), complex)
    s_yu = np.zeros((bins, outputs, inputs), complex)
    s_yy = np.zeros((bins, outputs))
    for u, y in experiments:
        U, Y = (_spectra(signal, segment, window) for signal in (u, y))
        s_uu += np.einsum("sfa,sfb->fab", U, U.conj())
        s_yu += np.einsum("sfa,sfb->fab", Y, U.conj())
        s_yy += np.sum(np.abs(Y) ** 2, axis=0)
    used = slice(1, None)  # the mean has been taken off
    power = np.trace(s_uu[used], axis1=1, axis2=2).real / inputs
    regular = s_uu[used] + 1e-14 * max(float(power.max()), 1e-300) * np.eye(inputs)
    solved = np.linalg.solve(regular.transpose(0, 2, 1), s_yu[used].transpose(0, 2, 1))
    response: Complex = np.asarray(solved.transpose(0, 2, 1), dtype=np.complex128)
    explained = np.einsum("fab,fab->fa", response, s_yu[used].conj()).real
    coherence = np.clip(explained / np.maximum(s_yy[used], 1e-300), 0.0, 1.0)
    whole = np.clip(explained.sum(axis=0) / s_yy[used].sum(axis=0), 0.0, 1.0)
    frequency = np.arange(1, bins) / (segment * dt)
    return FrequencyResponse(frequency, response, coherence, whole, averages)


def _count(experiments: Sequence[Experiment], segment: int) -> int:
    return sum(max(0, (len(u) - segment) // (segment // 2) + 1) for u, _ in experiments)


def _spectra(signal: Array, segment: int, window: NDArray[np.float64]) -> Complex:
    """Spectra (segments, f, channels) of a signal (n, channels) without its mean."""
    centred = signal - signal.mean(axis=0)
    if len(centred) < segment:
        return np.zeros((0, segment // 2 + 1, signal.shape[1]), complex)
    pieces = np.lib.stride_tricks.sliding_window_view(centred, segment, axis=0)[:: segment // 2]
    return np.asarray(np.fft.rfft(pieces * window, axis=2).transpose(0, 2, 1))
