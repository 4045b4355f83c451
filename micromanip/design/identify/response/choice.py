"""Order and delay of a model by a measured response that was held out, and whether the model is good enough.

Each order is fitted to the first half of a multisine's draws and judged by the rest; the smallest that is nearly as
good as the best is fitted to all. What is left between model and measurement, and what the measurement itself does not
know, is kept as a radius at each frequency: margins are judged with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from micromanip.control.system import Array, Complex, System, delay
from micromanip.design.identify.linear import Modes
from micromanip.errors import CheckFailed

from .measured import Measured, Multisine, measure, smoothed
from .rational import fit_rational

Recorded = tuple[Multisine, Array, Array]
"""What was played, and its records (n,) of input and output."""

ATTEMPTS, _LONGER = 2, 2
_ENOUGH = 1.15
_FLOOR = 0.01
"""A line is never trusted better than to this share: no model is exact, and none should chase one line."""
_WINDOW = 7
"""Lines over which the model's error is averaged: fewer would be the measurement's noise."""
_DELAY_ORDER = 6
_STATIC = (0.5, 2.0)
"""A model that is right on all lines may be anything below them."""
_SURE, _KNOWN = 2.0, 0.1
NOTHING = "nothing of the response stands out of its noise"
_TURNS, _MORE = 5, 2.0
"""How often a line of too large an error is trusted more, and by how much at most each time."""


@dataclass(frozen=True)
class Wanted:
    """Orders and delays (samples) to choose from, and what a higher order or a longer measurement is tried for.

    `error`: of the model beside the measurement, `confidence`: standard deviation of the measurement, both as shares,
    wherever the response is above `matters` of its median size, up to `upper_Hz`; above, only the radius tells.
    """

    orders: tuple[int, ...]
    delays: tuple[int, ...]
    error: float = 0.08
    confidence: float = 0.15
    matters: float = 0.25
    upper_Hz: float = np.inf


@dataclass(frozen=True)
class Identified:
    """The model, what it was fitted to, its `radius` (k,) of uncertainty at the lines, and what was tried.

    `tried` has the held-out error of each order, 1 being the measurement's own confidence. `problem` says in words
    what is less well known than was `Wanted`, None where nothing is. It refuses no design: whether the frequency
    matters is for the loop's margins within the radius, and for those measured in the loop.
    """

    modes: Modes
    delay: int
    dt: float
    measured: Measured
    radius: Array
    tried: dict[int, float]
    problem: str | None

    @property
    def order(self) -> int:
        """States, without those of the delay."""
        return self.modes.order

    @property
    def fit_percent(self) -> float:
        """100 less the rms of the relative error, in percent, over the lines that are known to 10 %."""
        known = self.measured.relative < _KNOWN
        return 100.0 * (1.0 - float(np.sqrt(np.mean(self.error[known] ** 2)))) if known.any() else 0.0

    @property
    def error(self) -> Array:
        """Error (k,) of the model in terms of the response, the noise of single lines averaged out."""
        return _error(self.at(self.measured.frequency_Hz), self.measured)

    def at(self, frequency_Hz: Array) -> Complex:
        """The model's response (f,), delay included."""
        z = np.exp(2j * np.pi * np.asarray(frequency_Hz) * self.dt)
        return np.asarray(self.modes.frequency_response(z)[:, 0, 0] * z**-self.delay)

    def system(self) -> System:
        """Model and delay, a step per sample."""
        dynamics = self.dynamics()
        return delay(self.delay, self.dt).then(dynamics) if self.delay else dynamics

    def dynamics(self) -> System:
        """The model without its delay."""
        A, B, C, _ = self.modes.state_space()
        return System(A, B[:, 0], C[0], 0.0, self.dt)

    def radius_at(self, omega: Array) -> Array:
        """Radius of uncertainty (n,) at angular frequencies (n,), rad/s; that of the end lines beyond them."""
        return np.asarray(np.interp(omega, 2 * np.pi * self.measured.frequency_Hz, self.radius))

    def unsure_at(self, omega: Array) -> Array:
        """The same as a share (n,) of the model's response."""
        hertz = self.measured.frequency_Hz
        share = self.radius / np.maximum(np.abs(self.at(hertz)), 1e-12)
        return np.asarray(np.interp(omega, 2 * np.pi * hertz, share))


def identify(measured: Measured, dt: float, wanted: Wanted) -> Identified:
    """The model of `measured` in the smallest order, and the delay, that the held-out draw asks for."""
    weight = np.hypot(measured.deviation, _FLOOR * np.abs(measured.response))
    half = len(measured.draws) // 2  # of a single draw all is seen
    seen, unseen = measured.draws[: max(half, 1)].mean(axis=0), measured.draws[half:].mean(axis=0)
    hertz = measured.frequency_Hz

    def held_out(order: int, late: int) -> float:
        modes = fit_rational(hertz, seen, weight, order, late, dt)
        z = np.exp(2j * np.pi * hertz * dt)
        error = modes.frequency_response(z)[:, 0, 0] * z**-late - unseen
        return float(np.sqrt(np.mean(np.abs(error / weight) ** 2)))

    def within(order: int) -> Identified:
        """Fitted so that no error is too large, which costs the others a little; else as it is best on the whole."""
        on_the_whole, trusted = None, weight
        for _ in range(_TURNS):
            modes = fit_rational(hertz, measured.response, trusted, order, delay, dt)
            plain = Identified(modes, delay, dt, measured, np.zeros(len(hertz)), tried, None)
            beside = np.where(_matters(measured, wanted), plain.error / wanted.error, 0.0)
            if not (beside > 1.0).any():  # another turn would trust the same, and find the same
                return plain if _STATIC[0] <= _static(plain) <= _STATIC[1] else on_the_whole or plain
            on_the_whole = on_the_whole or plain
            trusted = trusted / np.clip(beside, 1.0, _MORE)  # as Lawson did
        assert on_the_whole is not None
        return on_the_whole

    delay = wanted.delays[0]
    if len(wanted.delays) > 1:
        at = min(wanted.orders, key=lambda n: abs(n - _DELAY_ORDER))
        delay = min(wanted.delays, key=lambda late: held_out(at, late))
    tried = {order: held_out(order, delay) for order in wanted.orders}
    limit = _ENOUGH * min(tried.values())
    first = next(n for n, error in tried.items() if error <= limit)
    size, found = _size(measured), None
    # what the mean of all lines does not show, one mode that is missing, may take a larger order
    for order in (n for n in wanted.orders if n >= first):
        plain = within(order)
        radius = maximum_filter1d(np.maximum(plain.error * size, _SURE * measured.deviation), _WINDOW, mode="nearest")
        better = replace(plain, radius=radius, problem=_problem(plain, wanted))
        found = better if found is None or better.problem is None else found
        if found.problem is None:
            break
    assert found is not None
    return found


def _error(model: Complex, measured: Measured) -> Array:
    # what is the same over neighbouring lines is the model's, the rest the measurement's
    return np.abs(smoothed((model - measured.response) / _size(measured), _WINDOW))


def _size(measured: Measured) -> Array:
    """Of the response (k,), over neighbouring lines: a line that noise leaves nothing of would be none of theirs."""
    power = uniform_filter1d(np.abs(measured.response) ** 2, _WINDOW, mode="nearest")
    return np.asarray(np.sqrt(np.maximum(power, 1e-300)))


def _matters(measured: Measured, wanted: Wanted) -> NDArray[np.bool_]:
    size = np.abs(measured.response)
    return np.asarray((size >= wanted.matters * np.median(size)) & (measured.frequency_Hz <= wanted.upper_Hz))


def _problem(found: Identified, wanted: Wanted) -> str | None:
    measured = found.measured
    matters = _matters(measured, wanted)
    if not matters.any():
        return NOTHING
    sure = "the response is only known to +-{:.0f} %, +-{:.0f} % are needed"
    near = f"the model of order {found.order} is {{:.0f}} % beside the measured response, {{:.0f}} % are allowed"
    judged = ((measured.relative, wanted.confidence, _SURE, sure), (found.error, wanted.error, 1.0, near))
    for share, allowed, times, said in judged:
        at = int(np.argmax(np.where(matters, share, 0.0)))
        if matters[at] and share[at] > allowed:
            worse = said.format(100 * times * share[at], 100 * times * allowed)
            return f"at {measured.frequency_Hz[at]:.3g} Hz {worse}"
    if not _STATIC[0] <= _static(found) <= _STATIC[1]:
        return (
            f"at rest the model of order {found.order} has {_static(found):.2g} times the response that was measured "
            f"at {measured.frequency_Hz[0]:.3g} Hz"
        )
    return None


def _static(found: Identified) -> float:
    """The model's gain at rest over the response at the lowest lines: no line asks for it."""
    lowest = found.measured.response[:_WINDOW].real.mean()
    return float(found.at(np.zeros(1))[0].real / lowest) if lowest != 0.0 else np.inf


@dataclass(frozen=True)
class Attempted:
    """The model, the output (n,) that it was found from, and how often it was measured."""

    found: Identified
    output: Array
    attempts: int


def identify_again(record: Callable[[int, int], Recorded], wanted: Wanted, what: str, look_for: str) -> Attempted:
    """The model of what `record` measures: it is given the attempt, from 0, and how many times more to play.

    It is measured once more, for longer, where less is known than was `wanted`; then the model is what it is.
    Raises CheckFailed, "`what`: why. `look_for`", where no response stands out of the noise.
    """
    for attempt in range(ATTEMPTS):
        wave, u, y = record(attempt, _LONGER**attempt)
        measured = measure(wave, u, y)
        found = identify(measured, 1.0 / wave.rate_hz, wanted)
        if found.problem is None:
            break
    if not (measured.relative < wanted.confidence).any():
        raise CheckFailed(f"{what}: {NOTHING} in {ATTEMPTS} attempts. {look_for}")
    return Attempted(found, y, attempt + 1)
