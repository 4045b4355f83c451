"""Sensitivity of a loop of a running axis: by the response of its plant, as it was measured while everything runs.

The controller is known, the plant P = Y / U was measured between what is given to it and what its sensor says, with the
reference, the feedforward and the other loop as they are: L = C P. Beside it stands what the configuration predicts,
where it holds a model of the plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from micromanip.control.margins import Margins, margins
from micromanip.control.outer_gains import outer_gains
from micromanip.control.stage_loop import model_system, stage_loop
from micromanip.design.analyse.loops import over_path, strain_loop
from micromanip.errors import CheckFailed
from micromanip.replies import Response
from micromanip.settings.schema.accept import Accept
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker
from micromanip.settings.wiring.timing import FeedbackPath

from ..identify.actuation import DELAYS
from ..identify.response import Measured, Wanted, identify, of_spectra
from ..identify.response.choice import NOTHING
from .loop_analysis import analyse_inverse, slopes_of
from .sensitivity import AGREEMENT, SMALL_HZ, Sensitivity, judge_loop

DRAWS = 2
"""Injections with other phases: what differs between them is not linear."""
_WINDOW, _ORDERS = 3, tuple(range(4, 10))
"""Lines over which plant and model are compared; orders of a model through so few: a higher one swings between."""
_ERROR, _SURE, _MATTERS, _JUDGED_HZ = 0.12, 0.15, 0.05, 1500.0
"""How good that model must be, and up to where: above, the strain loop has little gain."""
_OPEN = 2.0
"""How many times the measured Ms the confidence may leave."""


@dataclass(frozen=True)
class Running:
    """A loop of `axis` as measured, at multiples `slopes` of the plant's gain, and `predicted` at the same, or None.

    `loop` holds lines and confidence; without a model of the plant its prediction is its own measurement.
    """

    axis: str
    loop: Sensitivity
    slopes: tuple[float, ...]
    measured: tuple[Margins, ...]
    predicted: tuple[Margins, ...] | None
    accept: Accept

    @property
    def agrees(self) -> bool | None:
        """Whether measurement and prediction are one within the bound of `commission`.

        None without a prediction, and where the confidence would let any prediction pass.
        """
        return None if self.predicted is None or self.is_open else self.loop.agrees and self.loop.seen

    @property
    def is_open(self) -> bool:
        """Whether the measurement leaves open what Ms is."""
        return self.confidence[1] > _OPEN * self.measured[self.nominal].sensitivity

    @property
    def confidence(self) -> tuple[float, float]:
        """Between what Ms lies: as sure as the line nearest to -1 is."""
        near = np.abs(1.0 + self.loop.measured)
        k, found = int(np.argmin(near)), self.measured[self.nominal].sensitivity
        share = float(2.0 * self.loop.deviation[k] / near[k])
        return found / (1.0 + share), found / max(1.0 - share, 1e-3)

    @property
    def worst(self) -> int:
        """Place of the slope with the largest measured Ms."""
        return int(np.argmax([found.sensitivity for found in self.measured]))

    @property
    def nominal(self) -> int:
        """Place of the slope 1."""
        return self.slopes.index(1.0)

    @property
    def problem(self) -> str | None:
        """Why the loop is not as it should be, or None."""
        if self.agrees is False:
            if not self.loop.seen:
                where = f"its lines end at {self.loop.frequency_Hz[-1]:.0f} Hz"
                return f"{where}, Ms is predicted at {self.loop.margins.peak_Hz:.0f} Hz: it is not measured"
            return (
                f"measured and predicted distance to -1 differ by {100 * self.loop.apart:.0f} % more than the "
                f"confidence at {self.loop.apart_Hz:.0f} Hz, {100 * AGREEMENT:.0f} % are allowed: the model is not the "
                "plant any more; commission the axis again"
            )
        found, nominal = self.measured[self.worst], self.measured[self.nominal].sensitivity
        least, most = self.confidence
        if self.is_open:
            return (
                f"Ms {nominal:.2f} may be anything from {least:.2f} to {most:.2f}: measure it held "
                "(`micromanip hold`), or with more --amplitude-um"
            )
        if found.gain_dB < self.accept.gain_margin_dB or found.phase_deg < self.accept.phase_margin_deg:
            return (
                f"{found.gain_dB:.1f} dB and {found.phase_deg:.0f} deg at {self.slopes[self.worst]:.2f} times the "
                f"slope, {self.accept.gain_margin_dB:g} dB and {self.accept.phase_margin_deg:g} deg are asked for"
            )
        return None


def judge_running(configuration: Configuration, path: FeedbackPath, axis: str, loop: str, plant: Measured) -> Running:
    """What the response of a loop's `plant` means."""
    settings, period_s = configuration.axes[axis], configuration.loop.period_ns * 1e-9
    if loop != "stage":
        found, slopes = _without_model(settings, path, plant, period_s), _slopes(settings, plant)
        return Running(axis, found, slopes, tuple(map(found.measured_margins, slopes)), None, settings.accept)
    outer = settings.outer
    if outer is None:
        raise CheckFailed(f"axis {axis} has no section outer")
    tracker = configuration.reference.of(axis) if isinstance(configuration.reference, Tracker) else None
    gains, model = outer_gains(outer, tracker, period_s), model_system(outer.model, period_s)
    around = stage_loop(gains, model, outer.sample_cycles, path.stage_late)
    predicted = margins(around)
    found = judge_loop("outer loop", plant, model, around, predicted, window=_WINDOW)
    return Running(axis, found, (1.0,), (found.measured_margins(),), (predicted,), settings.accept)


def _slopes(settings: Axis, plant: Measured) -> tuple[float, ...]:
    model = settings.hysteresis
    inverse = analyse_inverse(model, settings) if isinstance(model, PrandtlIshlinskii) else None
    seen_um_per_V = float(np.interp(SMALL_HZ, plant.frequency_Hz, np.abs(plant.response)))
    return slopes_of(settings, 1.0, inverse, seen_um_per_V)[1]


def _without_model(settings: Axis, path: FeedbackPath, plant: Measured, period_s: float) -> Sensitivity:
    """The measured loop by itself: between its lines runs the rational model that fits them best.

    A narrow mode has its peak of Ms between two lines. Raises CheckFailed where no model fits.
    """
    found = identify(plant, period_s, Wanted(_ORDERS, DELAYS, _ERROR, _SURE, _MATTERS, _JUDGED_HZ))
    if not (plant.relative < _SURE).any():
        raise CheckFailed(f"no margins: {NOTHING}; measure it held (`micromanip hold`), or with more --amplitude-um")
    around = strain_loop(settings.running_inner, over_path(found.system(), path))
    return judge_loop("strain loop", plant, found.system(), around, margins(around), window=_WINDOW)


def plant_of(responses: Sequence[Response]) -> Measured:
    """The plant's response from the spectra [period][line] = [re, im] of what goes in and comes out, of each draw."""
    U, Y = (np.array([each[name] for each in responses]) @ [1.0, 1j] for name in ("input", "output"))
    return of_spectra(np.asarray(responses[0]["frequency_Hz"]), U, Y)


def figures(found: Margins) -> dict[str, float]:
    """Margins as in JSON."""
    return {"Ms": found.sensitivity, "at_Hz": found.peak_Hz, "gain_dB": found.gain_dB, "phase_deg": found.phase_deg}


def document(found: Running, loop: str) -> dict[str, Any]:
    """A measured loop as JSON: margins at each slope, confidence, verdict, and the sensitivity at its lines."""
    lines, nominal = found.loop, found.nominal
    slopes = [
        {
            "slope": slope,
            "measured": figures(found.measured[k]),
            "predicted": None if found.predicted is None else figures(found.predicted[k]),
        }
        for k, slope in enumerate(found.slopes)
    ]
    return {
        "axis": found.axis,
        "loop": loop,
        **slopes[nominal],
        "slopes": slopes,
        "Ms_least": found.confidence[0],
        "Ms_most": found.confidence[1],
        "agrees": found.agrees,
        "apart_percent": None if found.predicted is None else 100.0 * lines.apart,
        "apart_Hz": None if found.predicted is None else lines.apart_Hz,
        "problem": found.problem,
        "frequency_Hz": lines.frequency_Hz.tolist(),
        "sensitivity": (1.0 / abs(1.0 + lines.measured)).tolist(),
        "sensitivity_predicted": None if found.predicted is None else (1.0 / abs(1.0 + lines.predicted)).tolist(),
    }
