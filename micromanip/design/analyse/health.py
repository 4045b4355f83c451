"""Whether an axis is still the stage that was commissioned: its figures beside the model, its margins beside `accept`.

The figures come out of the responses that a small multisine measures while the axis is held. The stage follows its
set-point like a flexure, whatever closes the strain loop below: about its first mode

    G(s) = k e^(-s tau) w^2 / (s^2 + 2 zeta w s + w^2),

fitted to the lines up to half again the mode by least squares of the relative error, lines far off counting less: what
the confidence says of single lines near a mode would leave its damping to its flanks. The actuator's gain is the mean
of its response's size over its lowest lines.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from micromanip.control.injection import highest_Hz, injection
from micromanip.control.system import Array, System
from micromanip.errors import CheckFailed
from micromanip.settings.schema.accept import Accept
from micromanip.settings.schema.axis import Axis
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.timing import FeedbackPath

from ..identify.response import Measured
from .live_margins import judge_running
from .loops import SPREAD, damped, flexure_mode, model_dynamics, residues

_ABOVE, _SCATTER, _LATEST_S = 1.5, 0.05, 2e-3
_SLOW, _LEAST_LINES = 10, 8
"""Lines that gains are the mean of; as many must lie about a mode."""
_ASTRAY = 0.15
_SLOWEST = math.sqrt((1.0 - SPREAD.stiffness) / (1.0 + SPREAD.stage_mass))
_FASTEST = math.sqrt((1.0 + SPREAD.stiffness) / (1.0 - SPREAD.stage_mass))
DRAWN = {
    "mode_Hz": (_SLOWEST, _FASTEST),
    "mode_damping": (1.0 - SPREAD.damping, 1.0 + SPREAD.damping),
}
"""Shares of a model's figure within which plants are drawn when a tuning's robustness is judged."""
_SURELY, _SURE = 0.95, 2.0
"""Many a tuning was made right up to what is accepted: a margin is below that by 5 %, and by twice what it is known
to."""
DRAWS = 2
"""Injections for each loop: 10 s."""
LABELS = {
    "stage_gain": "stage gain, um/um",
    "mode_Hz": "mode, Hz",
    "mode_damping": "damping ratio",
    "actuator_um_per_V": "actuator, um/V",
}
"""The figures, for people."""
MARGINS = {"stage_gain_dB": "dB", "stage_phase_deg": "deg"}
"""Of the outer loop, with their units."""


@dataclass(frozen=True)
class PlantFigures:
    """um of the stage for a um of set-point, first mode and its damping ratio, um of the stack for a volt.

    NaN where an axis has no such figure: no stage sensor, no mode, strain loop open.
    """

    stage_gain: float = np.nan
    mode_Hz: float = np.nan
    mode_damping: float = np.nan
    actuator_um_per_V: float = np.nan


def commissioned(model: System) -> PlantFigures:
    """The same of a configuration's `model` from set-point to stage, without its delay; of the actuator it has none.

    Where it has a mode, that flexure is fitted to its response, line by line, as to a measured one: the gain about the
    mode is not that at rest, where the strain loop below or a mode above bends the response.
    """
    poles, strengths = residues(model)
    gain = float(model.response(np.array([2 * np.pi]))[0].real)
    k = flexure_mode(poles, strengths)
    if k is None:
        return PlantFigures(stage_gain=gain)
    of_the_pole = PlantFigures(gain, *damped(poles[k], model.period_s))
    rate_hz = 1.0 / model.period_s
    hertz = injection(1.0, highest_Hz(rate_hz), rate_hz, seed=1).frequency_Hz
    try:
        return PlantFigures(*_mode(hertz, model.response(2 * np.pi * hertz), of_the_pole))
    except CheckFailed:  # no flexure: what is measured of it will not be one either, and is told
        return of_the_pole


def plant_figures(stage: Measured | None, strain: Measured | None, near: PlantFigures) -> PlantFigures:
    """What the responses from set-point to stage and from voltage to gauge say; None: that loop is not closed.

    `near` are the figures to begin with. Raises CheckFailed where no mode is found in the stage's response.
    """
    actuator = np.nan
    if strain is not None:
        slow = np.argsort(strain.frequency_Hz)[:_SLOW]
        actuator = float(np.exp(np.mean(np.log(np.abs(strain.response[slow])))))
    if stage is None:
        return PlantFigures(actuator_um_per_V=actuator)
    if np.isnan(near.mode_Hz):
        slow = np.argsort(stage.frequency_Hz)[:_SLOW]
        return PlantFigures(stage_gain=float(np.mean(stage.response[slow].real)), actuator_um_per_V=actuator)
    gain, mode_Hz, damping = _mode(stage.frequency_Hz, stage.response, near)
    return PlantFigures(gain, mode_Hz, damping, actuator)


def _mode(lines_Hz: Array, stage: NDArray[np.complex128], near: PlantFigures) -> tuple[float, float, float]:
    """Gain, mode and damping: the mode first where the response is highest, then all by least squares."""
    upper = lines_Hz <= _ABOVE * near.mode_Hz
    if np.count_nonzero(upper) < _LEAST_LINES:
        raise CheckFailed(f"only {np.count_nonzero(upper)} lines lie below {_ABOVE * near.mode_Hz:.0f} Hz")
    hertz, response = lines_Hz[upper], stage[upper]
    s = 2j * np.pi * hertz

    def modelled(x: Array) -> NDArray[np.complex128]:
        w = 2 * np.pi * np.exp(x[1])
        return np.asarray(np.exp(x[0] - s * x[3]) * w**2 / (s**2 + 2 * np.exp(x[2]) * w * s + w**2))

    def residual(x: Array) -> Array:
        apart = modelled(x) / response - 1.0
        return np.concatenate([apart.real, apart.imag])

    highest = float(hertz[np.argmax(np.abs(response))])
    starts = [[np.log(near.stage_gain), np.log(f), np.log(near.mode_damping), 1e-4] for f in (near.mode_Hz, highest)]
    bounds = ([-7.0, np.log(0.3 * near.mode_Hz), -9.0, 0.0], [7.0, np.log(3.0 * near.mode_Hz), 0.0, _LATEST_S])
    fits = (
        least_squares(residual, np.clip(x, *bounds), bounds=bounds, loss="soft_l1", f_scale=_SCATTER) for x in starts
    )
    found = min(fits, key=lambda fit: float(fit.cost))
    apart = float(np.median(np.abs(modelled(found.x) / response - 1.0)))
    if apart > _ASTRAY:
        raise CheckFailed(
            f"no mode near {near.mode_Hz:.0f} Hz fits the stage's response: a line is {100 * apart:.0f} % off, "
            f"{100 * _ASTRAY:.0f} % may be; measure it held (`micromanip hold`), or commission the axis again"
        )
    gain, mode, damping = np.exp(found.x[:3])
    return float(gain), float(mode), float(damping)


@dataclass(frozen=True)
class Check:
    """An axis as it was measured: its figures, those of its model, its margins with their deviations; NaN: it has none.

    `problems` say what is not as it was commissioned.
    """

    axis: str
    figures: PlantFigures
    tuned: PlantFigures
    margins: Mapping[str, float] = field(default_factory=dict)
    deviations: Mapping[str, float] = field(default_factory=dict)
    problems: tuple[str, ...] = ()

    def change(self, name: str) -> float:
        """Share by which a figure is more than in the model."""
        return float(getattr(self.figures, name) / getattr(self.tuned, name) - 1.0)


def problems_of(check: Check, accept: Accept) -> Iterator[str]:
    """Figures outside what robustness was judged for, margins that are surely below what is accepted."""
    for name, (low, high) in DRAWN.items():
        share = 1.0 + check.change(name)
        if share < low or share > high:  # never where there is no such figure
            yield (
                f"{name} is {getattr(check.figures, name):.4g}, {getattr(check.tuned, name):.4g} in the model: "
                f"robustness was judged within {100 * (low - 1):+.0f} to {100 * (high - 1):+.0f} % of it"
            )
    for name, least in zip(MARGINS, (accept.gain_margin_dB, accept.phase_margin_deg), strict=True):
        found, known = check.margins.get(name, math.nan), _SURE * check.deviations.get(name, math.nan)
        if found < least - np.fmax((1.0 - _SURELY) * least, known):
            within = "" if math.isnan(known) else f", known to {known:.2g}"
            yield f"{name} is {found:.3g}{within}: at least {least:g} is asked for (`accept`)"


def closed_loops(axis: Axis, name: str) -> tuple[str, ...]:
    """The loops of an axis that can be measured; CheckFailed where there is none."""
    stage = ("stage",) if axis.mode == "stage" and axis.outer is not None else ()
    strain = ("strain",) if axis.mode != "voltage" and axis.inner.mode != "feedforward" else ()
    if not stage + strain:
        raise CheckFailed(
            f"axis {name}: no loop is closed (mode {axis.mode}, inner.mode {axis.inner.mode}): nothing to measure"
        )
    return stage + strain


def checked(configuration: Configuration, path: FeedbackPath, axis: str, responses: Mapping[str, Measured]) -> Check:
    """What `responses`, by the names of their loops, say of an axis."""
    settings = configuration.axes[axis]
    outer, period_s = settings.outer, configuration.loop.period_ns * 1e-9
    tuned = PlantFigures() if outer is None else commissioned(model_dynamics(outer.model, period_s))
    figures = plant_figures(responses.get("stage"), responses.get("strain"), tuned)
    margins, deviations = {}, {}
    if "stage" in responses:
        found = judge_running(configuration, path, axis, "stage", responses["stage"])
        nominal = found.measured[found.nominal]
        margins = dict(zip(MARGINS, (nominal.gain_dB, nominal.phase_deg), strict=True))
        deviations = dict(zip(MARGINS, found.loop.margin_deviations(), strict=True))
    check = Check(axis, figures, tuned, margins, deviations)
    return replace(check, problems=tuple(problems_of(check, settings.accept)))
