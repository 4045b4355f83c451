"""Plots of a commissioned axis as data: the stage's response and the orders tried, step, disturbance."""

from __future__ import annotations

import numpy as np

from ..report.model import Curve, Plot
from ..tuning import StageModel
from .validation import Validation

_COHERENT = 0.8


def tried_orders(stage: StageModel) -> Plot:
    """Held-out error of each order of the stage's model."""
    tried = stage.found.tried
    order, error = np.array(list(tried), dtype=float), np.array(list(tried.values()))
    curve = Curve("held-out error", order, error, marks=True)
    note = f"1 is the measurement's own confidence; order {stage.found.order} is used."
    return Plot("Order of the stage's dynamics", "order", "error", (curve,), note, log_y=True)


def measured_response(stage: StageModel) -> tuple[Plot, ...]:
    """Set-point to stage: model beside the measured response, and its coherence."""
    measured = stage.found.measured
    hertz, seen = measured.frequency_Hz, measured.response
    pairs = (("measured", seen), ("model", stage.found.at(hertz)))
    gain = tuple(Curve(name, hertz, np.abs(values)) for name, values in pairs)
    model = np.unwrap(np.angle(pairs[1][1]))
    # measured beside the model: its own unwrapping is lost where there is noise only
    angle = np.degrees(model + np.angle(seen / pairs[1][1]))
    told = measured.coherence >= _COHERENT
    phase = (
        Curve("measured", hertz, np.where(told, angle, np.nan)),
        Curve("model", hertz, np.degrees(model)),
        Curve(f"coherence below {_COHERENT:g}", hertz, np.where(told, np.nan, angle), faint=True),
    )
    coherence = (Curve("coherence", hertz, measured.coherence),)
    beside = 100.0 * np.abs(pairs[1][1] / seen - 1.0)
    error = (
        Curve("error", hertz, np.where(told, beside, np.nan)),
        Curve(f"coherence below {_COHERENT:g}", hertz, np.where(told, np.nan, beside), faint=True),
    )
    return (
        Plot("Set-point to stage: gain", "frequency, Hz", "um/um", gain, log_x=True, log_y=True),
        Plot("Set-point to stage: phase", "frequency, Hz", "degrees", phase, log_x=True),
        Plot(
            "Coherence",
            "frequency, Hz",
            "",
            coherence,
            "Where it is low, the measured curve means nothing.",
            log_x=True,
        ),
        Plot("Model beside the measured response", "frequency, Hz", "%", error, log_x=True, log_y=True),
    )


def responses(check: Validation) -> tuple[Plot, Plot]:
    """Step of the stage, and what a disturbance does with and without the outer loop."""
    t_s, reference, stage = check.step
    step = (Curve("reference", 1e3 * t_s, reference), Curve("capacitive sensor", 1e3 * t_s, stage))
    late, without, closed = check.rejected
    both = (Curve("without outer loop", 1e3 * late, without), Curve("with outer loop", 1e3 * late, closed))
    return (
        Plot("Step of the stage, outer loop closed", "time, ms", "um", step, "Played on a fresh experiment."),
        Plot("Disturbance of 1 um at the set-point", "time, ms", "stage, um", both, "By the identified model."),
    )
