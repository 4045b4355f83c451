"""Excitation signals: the multisine (13), the shrinking triangle of figure 2, random turning points."""

from __future__ import annotations

import itertools

import numpy as np

from micromanip.control.system import Array

IDENTIFICATION_HZ = (0.3, 1.0, 2.3, 5.1, 9.7)
IDENTIFICATION_SHARE = (20.0, 13.0, 10.0, 8.0, 5.0)
_SLEW_SHARE = 0.5
_PHASE_TRIALS = 300
_RAMP_S = 0.5
_BRANCH_S = (0.04, 0.5)
_SHORTEST_BRANCH = 0.02


def half_cosine(count: int) -> Array:
    """From 0 to 1 (n,), at rest at both ends."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.arange(count) / count))


def soft(wave: Array, rest: float, rate_hz: float, slew_per_s: float = np.inf) -> Array:
    """`wave` (n,) led in from `rest`, and out to it again, without a jump and well below the slew limit."""
    farthest = max(abs(wave[0] - rest), abs(wave[-1] - rest))
    count = round(max(_RAMP_S, 0.5 * np.pi * farthest / (_SLEW_SHARE * slew_per_s)) * rate_hz)
    lead = half_cosine(count)
    start = rest + lead * (wave[0] - rest)
    return np.concatenate([start, wave, (rest + lead * (wave[-1] - rest))[::-1]])


def multisine(
    low: float,
    high: float,
    slew_per_s: float,
    rate_hz: float,
    seconds: float,
    seed: int,
) -> Array:
    """Multisine (13), (n,), that just fills `low` .. `high` and stays well below the slew limit.

    The phases are the best of some hundred seeded draws: the lower the crest factor, the more of the
    stroke is covered often. Amplitudes have the given proportions. Where an output is too slow for it, all of it is
    played up to six times as slowly: a hysteresis model has to have seen the stroke, not the frequencies.
    """
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    omega = 2.0 * np.pi * np.array(IDENTIFICATION_HZ)
    amplitude = np.array(IDENTIFICATION_SHARE)
    rng = np.random.default_rng(seed)
    coarse = t[:: max(1, round(rate_hz / (20.0 * max(IDENTIFICATION_HZ))))]
    trials = rng.uniform(0.0, 2.0 * np.pi, (_PHASE_TRIALS, len(omega)))
    waves = np.einsum("i,kit->kt", amplitude, np.sin(omega[None, :, None] * coarse + trials[:, :, None]))
    phases = trials[np.argmin(np.ptp(waves, axis=1))]
    speed = (amplitude * omega) @ np.cos(omega[:, None] * t + phases[:, None])
    filled, allowed = (high - low) / float(np.ptp(waves, axis=1).min()), _SLEW_SHARE * slew_per_s / np.abs(speed).max()
    slower = float(np.clip(filled / allowed, 1.0, 6.0))
    t = np.arange(round(slower * seconds * rate_hz)) / (slower * rate_hz)
    wave = amplitude @ np.sin(omega[:, None] * t + phases[:, None])
    size = min((high - low) / float(np.ptp(wave)), slower * allowed)
    return np.asarray(0.5 * (low + high) + size * (wave - 0.5 * (wave.max() + wave.min())))


def shrinking_triangle(low: float, high: float, turns: int, samples_per_turn: int) -> Array:
    """Linear course from `low` to `high` and back (figure 2), each of `turns` loops smaller by the same step."""
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    corners = [low]
    for k in range(turns):
        size = half * (1.0 - k / turns)
        corners += [centre + size, centre - size]
    pieces = [np.linspace(a, b, samples_per_turn, endpoint=False) for a, b in itertools.pairwise(corners)]
    return np.concatenate([*pieces, [corners[-1]]])


def random_turns(low: float, high: float, slew_per_s: float, rate_hz: float, seconds: float, seed: int) -> Array:
    """Half cosines (n,) between random turning points in `low` .. `high`, well below the slew limit.

    Branches of every length begin at every place, at speeds spread evenly in proportion: the multisine has few long
    ones. What is learnt from examples, not from a structure, has to have seen them.
    """
    rng = np.random.default_rng(seed)
    samples, here, upwards = round(seconds * rate_hz), 0.5 * (low + high), True
    pieces, count = [np.array([here])], 1
    while count < samples:
        there = rng.uniform(here, high) if upwards else rng.uniform(low, here)
        upwards = not upwards
        way = there - here
        if abs(way) < _SHORTEST_BRANCH * (high - low):
            continue
        branch_s = max(np.exp(rng.uniform(*np.log(_BRANCH_S))), 0.5 * np.pi * abs(way) / (_SLEW_SHARE * slew_per_s))
        steps = max(2, int(np.ceil(branch_s * rate_hz)))
        pieces.append(here + way * (0.5 - 0.5 * np.cos(np.pi * np.arange(1, steps + 1) / steps)))
        here, count = there, count + steps
    return np.concatenate(pieces)[:samples]
