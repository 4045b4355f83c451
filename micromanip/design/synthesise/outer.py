"""The outer loop by two human knobs: how fast (bandwidth), and how noisy the capacitive sensor is.

The LQG of `control/outer_gains.py` answers two questions that have little to do with one another. How the stage follows
its reference, and how a mode that was excited is damped, is the regulator's affair: the control weight. How quickly a
disturbance is noticed, and how far the model is trusted in that, is the filter's: random walk and noise of the
set-point, in terms of the sensor's noise. So both are searched: of all regulators whose step of the stage is as the
user accepts, and of all filters with each, the pair that leaves least of a disturbance and of the sensor's noise
together, with its margins, wherever within its uncertainty the plant may be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from micromanip.control.margins import Margins, Unsure
from micromanip.control.outer_gains import OuterGains
from micromanip.errors import CheckFailed
from micromanip.settings.schema.axis import LinearModel, Outer

from ..analyse.saturation import Reach
from ..validate.step import StepAnswer
from .search import FRAGILE, HOPELESS, ROBUST, SLEWED, UNKNOWN, Search, Task, highest_Hz

GAIN_DB, PHASE_DEG = 6.0, 35.0
OVERSHOOT, SETTLING_S = 0.4, 0.05
_STEP_SHARE = 0.8
"""What may be had of what is accepted of the step: the next identification gives a slightly other model."""
_CONTROL_WEIGHTS, _BETWEEN = np.geomspace(0.1, 1000.0, 9), (10.0**-0.25, 10.0**0.25)
"""Of a first look, and beside the best of it."""


@dataclass(frozen=True)
class OuterDesign:
    """The tuning with its margins.

    `step` is what the model makes of the stage's step; `limited_by` says in words what stands in the way of more;
    `obstacle` is what bolder designs failed by most often, empty where none did.
    """

    outer: Outer
    margins: Margins
    bandwidth_Hz: float
    step: StepAnswer
    limited_by: str
    obstacle: str = ""


def tune_outer(
    model: LinearModel,
    period_s: float,
    noise_um: float,
    *,
    unsure: Unsure = np.zeros_like,
    bears: Callable[[Outer, OuterGains], bool] | None = None,
    reach: Reach | None = None,
    gain_dB: float = GAIN_DB,
    phase_deg: float = PHASE_DEG,
    overshoot: float = OVERSHOOT,
    settling_s: float = SETTLING_S,
    bandwidth_Hz: float | None = None,
    oscillation_Hz: float | None = 200.0,
    sample_cycles: int = 1,
    late_cycles: int = 0,
) -> OuterDesign:
    """LQG for `model` (um by um, a step each `period_s`) that leaves least, with at least 6 dB and 35 degrees.

    Or the one of `bandwidth_Hz`: section 4.5 of the paper.

    `noise_um` is the sensor's rms; `bandwidth_Hz` the highest crossover of the loop; a sample is seen
    `late_cycles` after it was taken. The stage's step is to stay below `overshoot` (a share of it) and settle within
    `settling_s`, with a reserve; where no loop does, the one that comes nearest is taken, and said. `unsure` gives the
    uncertainty of the model's response at angular frequencies as a share of it: wherever the plant is within, Ms stays
    below 3. Within `reach` a swing of the mode dies out, of whatever size. `bears` is asked whether
    a design that has its margins also bears what else it must. Raises CheckFailed where
    the margins are not to be had, with what is.
    """
    task = Task(
        model, period_s, noise_um, oscillation_Hz, sample_cycles, late_cycles, unsure, bears, reach, gain_dB, phase_deg
    )

    def excess(step: StepAnswer) -> float:
        return max(step.overshoot / max(overshoot, 0.01), step.settling_s / settling_s) / _STEP_SHARE

    regulators = sorted((task.regulator(weight) for weight in _CONTROL_WEIGHTS), key=lambda each: excess(each[2]))
    good = [each for each in regulators if excess(each[2]) <= 1.0]
    search = Search(task, bandwidth_Hz)
    search.look(good)
    if search.best is not None:
        beside = [task.regulator(search.best[1].outer.control_weight * factor) for factor in _BETWEEN]
        search.look([each for each in beside if excess(each[2]) <= 1.0])
        search.refine(excess)
    for regulator in regulators[len(good) :]:
        if search.best is not None:
            break
        search.look([regulator])
    if search.best is None:
        search.descend(regulators)
    best = search.best
    asked = "" if bandwidth_Hz is None else f" at {bandwidth_Hz:g} Hz"
    if best is None or (bandwidth_Hz is not None and best[1].bandwidth_Hz < 0.8 * bandwidth_Hz):
        raise CheckFailed(_refused(search, asked, gain_dB, phase_deg))
    _, candidate, found, step = best
    crossover = highest_Hz(found.crossovers_Hz, oscillation_Hz)
    most = max(set(search.obstacles), key=search.obstacles.count, default="")
    limited = _limited(step, excess(step) <= 1.0, most)
    return OuterDesign(candidate.outer, found, crossover, step, limited, most)


def _limited(step: StepAnswer, good: bool, most: str) -> str:
    """What stands in the way of more, and what would help."""
    if not good:
        return (
            f"the step limits it: no regulator with its margins does better than {100 * step.overshoot:.0f} % of "
            f"overshoot and {1e3 * step.settling_s:.0f} ms: a stiffer or better damped flexure, or less delay, would "
            "allow more"
        )
    if not most:
        return "nothing limits it: faster loops would only pass on more of the sensor's noise"
    helps = {
        UNKNOWN: "a response measured with less noise",
        FRAGILE: "more damping of the flexure's mode, less delay",
        SLEWED: "a faster set-point (setpoint.slew_um_per_ms, where the amplifier gives it), more damping of the mode",
    }
    return f"{most} limits it: {helps.get(most, 'less delay, or a stiffer flexure,')} would allow more"


def _refused(search: Search, asked: str, gain_dB: float, phase_deg: float) -> str:
    """Why there is no loop."""
    if not asked and FRAGILE in search.obstacles:
        return (
            "outer loops have their margins around the model, but not over the plants drawn around it: more "
            "damping of the flexure's mode, or less delay, would help; or allow more in accept.robust_sensitivity"
        )
    if not asked and UNKNOWN in search.obstacles:
        return (
            f"outer loops have their margins around the model, but not {gain_dB:g} dB and Ms below {ROBUST:g} within "
            "all that the measured response leaves open: measure with less noise, or ask for a calmer loop with --noise"
        )
    if not asked and SLEWED in search.obstacles:
        return (
            "outer loops have their margins, but after a large swing the set-point's slew limit keeps the mode "
            "swinging: allow a faster set-point (setpoint.slew_um_per_ms) where the amplifier gives it, add damping to "
            "the mode, or identify the model again"
        )
    if not search.tried:
        return f"no outer loop{asked} is stable with Ms below {HOPELESS:g}: identify the model again"
    closest = max(search.tried, key=lambda entry: min(entry[2] - gain_dB, (entry[3] - phase_deg) / 6.0))
    return (
        f"no outer loop{asked} has margins of {gain_dB:g} dB and {phase_deg:g} deg; the best has "
        f"{closest[2]:.1f} dB and {closest[3]:.0f} deg at {closest[1]:.0f} Hz: ask for less bandwidth, or identify "
        "the model again"
    )
