"""Sensitivity of a closed loop, measured while it is closed: a small multisine on top of what it follows.

Whatever enters a loop, plant P and controller C are seen as ``Y = P U``, so with the known C

    L = C Y / U,   S = 1 / (1 + L) = U / (U + C Y).

The measured P is taken relative to the model's: the ratio is smooth where the model is right, so it can be averaged
over neighbouring lines without a resonance being lost, and gives margins at any frequency. Where it is not near 1, the
model is not the plant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from micromanip.control.margins import Margins, curve_margins, refined
from micromanip.control.system import Array, Complex, System

from ..identify.response import Measured, smoothed

Response = Callable[[Array], Complex]

AGREEMENT = 0.2
"""How far the measured distance to -1 may be from the predicted one, beyond its confidence, as a share."""
KEPT = 0.8
"""Share of the predicted margins that the measured ones must have."""
_SURE, _UNKNOWN = 2.0, 20.0
WINDOW, _NARROW = 7, 3
"""Lines over which measured and modelled plant are compared by default; by fewer it is seen what that flattens."""
_MARGIN_DRAWS = 24
SMALL_HZ, _SMALL_LINES = 20.0, 31
"""Where a response shows the slope of its small swing: below, creep and a lag of the hysteresis add to it."""
_JUDGED = 1.25
"""Where 1/|S| is below this, the sensitivity matters: further away from -1 nothing happens."""


@dataclass(frozen=True)
class Sensitivity:
    """A loop measured while closed: at (k,) lines `measured` and `predicted` L, and the deviation of the measured.

    `model` is the predicted L as a function, `margins` its margins; `least` and `most` are the smallest and the largest
    Ms that the confidence of the measurement leaves, at the lines and between. `apart` is by how much more than that
    confidence both differ at worst, as a share of the distance to -1, at `apart_Hz`.
    """

    name: str
    frequency_Hz: Array
    measured: Complex
    predicted: Complex
    deviation: Array
    model: Response
    margins: Margins
    least: float
    most: float
    apart: float
    apart_Hz: float

    @property
    def agrees(self) -> bool:
        """Whether prediction and measurement are one within `AGREEMENT`."""
        return self.apart <= AGREEMENT

    @property
    def as_predicted(self) -> bool:
        """The same, and its margins are those that were predicted, but for a share of `KEPT`."""
        return self.agrees and kept([self.measured_margins()], [self.margins])

    def at_slopes(self, slopes: Sequence[float]) -> list[Margins]:
        """Measured margins at multiples of the identified slope; the one measured is that of another swing."""
        near = np.argsort(np.abs(np.log(self.frequency_Hz / SMALL_HZ)))[:_SMALL_LINES]
        own = float(np.median(np.abs(self.measured / self.predicted)[near]))
        return [self.measured_margins(slope / own) for slope in slopes]

    @property
    def seen(self) -> bool:
        """Whether the lines reach to where the predicted loop is nearest to -1: what is not measured is not claimed."""
        return bool(self.frequency_Hz[0] <= self.margins.peak_Hz <= self.frequency_Hz[-1])

    @property
    def between(self) -> str:
        """The Ms that the measurement's confidence leaves, in words."""
        if self.most > _UNKNOWN:
            return f"at least {self.least:.2f}, its upper end was not measured"
        return f"{self.least:.2f} to {self.most:.2f}"

    @property
    def sentence(self) -> str:
        """Both, in words."""
        found = self.measured_margins().sensitivity
        return (
            f"{self.name}: Ms {found:.2f} measured ({self.between}), "
            f"{self.margins.sensitivity:.2f} predicted; at {self.apart_Hz:.0f} Hz their distances to -1 differ by "
            f"{100 * self.apart:.0f} % more than the measurement's confidence"
        )

    def measured_margins(self, slope: float = 1.0) -> Margins:
        """Margins of the measured loop with `slope` times its gain, over the lines' frequencies; stability unknown."""
        return self._margins(slope * self.measured)

    def margin_deviations(self) -> tuple[float, float]:
        """Standard deviations of the measured gain (dB) and phase margin (degrees), by drawing what L may be.

        Infinite where one of the drawn margins is: nothing bounds it.
        """
        random = np.random.default_rng(0)
        found = []
        for _ in range(_MARGIN_DRAWS):
            apart = random.normal(size=(2, len(self.measured))) * np.sqrt(0.5)
            drawn = self._margins(self.measured + self.deviation * (apart[0] + 1j * apart[1]))
            found.append((drawn.gain_dB, drawn.phase_deg))
        bounded = np.isfinite(found).all(axis=0)
        gain_dB, phase_deg = np.where(bounded, np.where(bounded, found, 0.0).std(axis=0), np.inf)
        return float(gain_dB), float(phase_deg)

    def _margins(self, measured: Complex) -> Margins:
        ratio, omega = measured / self.predicted, 2 * np.pi * self.frequency_Hz

        def response(w: Array) -> Complex:
            return np.asarray(self.model(w) * np.interp(w, omega, ratio))

        return curve_margins(response, omega)


def least(found: Sequence[Margins]) -> tuple[float, float]:
    """The least gain (dB) and the least phase margin (degrees) of a loop at several slopes."""
    return min(m.gain_dB for m in found), min(m.phase_deg for m in found)


def kept(measured: Sequence[Margins], claimed: Sequence[Margins]) -> bool:
    """Whether those measured have a share of `KEPT` of the least that are `claimed`."""
    return all(found >= KEPT * said for found, said in zip(least(measured), least(claimed), strict=True))


def judge_loop(
    name: str, plant: Measured, model: System, loop: System, predicted: Margins, window: int = WINDOW
) -> Sensitivity:
    """Sensitivity of the `loop` that was designed around `model`, by the `plant` as it was measured in it.

    Behind a bus `loop` steps from sample to sample: then only lines up to half of their rate count, and what is beyond
    is taken to be filtered by the plant. `window`: lines over which plant and model are compared.
    """
    lines = 2 * np.pi * plant.frequency_Hz
    G = model.response(lines)
    single = plant.response / G
    ratio, narrow = smoothed(single, window), smoothed(single, _NARROW)
    scatter = uniform_filter1d((plant.deviation / np.abs(G)) ** 2, window, mode="nearest")
    # of a mean of lines whose errors are independent; and where the model lacks something, a mean flattens it
    relative = np.sqrt(scatter / window) + np.abs(ratio - narrow) / _SURE
    # between the lines, too: a light mode's peak need not stand on one
    omega, L = refined(lambda w: np.asarray(loop.response(w) * np.interp(w, lines, ratio)), lines)
    expected = loop.response(omega)
    sure = _SURE * np.abs(expected) * np.interp(omega, lines, relative)
    near, far = np.abs(1.0 + L), np.abs(1.0 + expected)
    judged = np.minimum(near, far) < _JUDGED
    beyond = np.where(judged, np.maximum(np.abs(near - far) - sure, 0.0) / far, 0.0)
    k = int(np.argmax(beyond))
    expected = loop.response(lines)
    return Sensitivity(
        name,
        plant.frequency_Hz,
        expected * ratio,
        expected,
        np.abs(expected) * relative,
        loop.response,
        predicted,
        float(1.0 / (near + sure)[judged].min(initial=np.inf)),
        float(1.0 / np.maximum(near - sure, 1e-3)[judged].min(initial=1e3)),
        float(beyond[k]),
        float(omega[k] / (2 * np.pi)),
    )
