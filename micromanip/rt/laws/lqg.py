"""Outer loop of one axis (section 4.5): state feedback on the estimate, with reference feedforward.

``u = G w - K x``: x is the estimate of ``estimator.py`` and w the reference's own state (position,
velocity, acceleration, oscillations; ``reference.py``). Integral action is the gain on the
estimated input disturbance; G and the gains on disturbances solve the regulator equations, so
that, in the model, every such reference is followed and every such disturbance cancelled
without error. The actuation delay is part of the model. Gains come from
``micromanip.control.outer_gains``, which refuses a loop whose closed-loop poles are not inside the
unit circle.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record
from micromanip.rt.sums import weighted

from .estimator import MATRICES, MAX_STATES, MODEL, filled
from .reference import REFERENCE_STATES

OUTER_PARAMETERS = record(
    *MODEL,
    ("feedback", "f8", (MAX_STATES,)),
    ("reference_states", "i8"),
    ("reference", "f8", (REFERENCE_STATES,)),
    ("far_feedback", "f8", (MAX_STATES,)),
    ("far_reference", "f8", (REFERENCE_STATES,)),
    *MATRICES,
)
"""The estimator's model with K and G, per cycle, for near the path and far from it; G has `reference_states`."""
OUTER_STATE = record(("bridge_um", "f8"))
"""Offset of the set-point from the demand: it bridges the jump of any change of the law, and fades."""


@compiled
def outer_setpoint(p: Record, feedback: Any, reference: Any, x: Any, w: Any) -> float:
    """Actuator set-point (um, relative to the working point) for estimate `x` and reference `w`, by gains of `p`."""
    return weighted(reference, w, p["reference_states"]) - weighted(feedback, x, filled(p))
