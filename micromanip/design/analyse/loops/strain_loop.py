"""The strain loop of one axis: PID (17) as it runs, around the actuator from voltage to strain gauge."""

from __future__ import annotations

import numpy as np

from micromanip.control.pid import pid_system
from micromanip.control.system import System, delay
from micromanip.settings.schema.axis import Inner
from micromanip.settings.wiring.timing import FeedbackPath

from .perturbation import Shift, section_ratio, shifted


def over_path(actuator: System, path: FeedbackPath) -> System:
    """`actuator` as the PID sees it over a bus: late, and a step from sample to sample."""
    late = path.strain_late + path.output_late
    behind = delay(late, actuator.period_s).then(actuator) if late else actuator
    return behind.resampled(path.strain_cycles)


def strain_loop(inner: Inner, actuator: System, slope: float = 1.0) -> System:
    """Loop transfer, broken at the voltage; `slope` is the actuator's gain as a multiple of that of `actuator`.

    The PID steps at the period of `actuator`: behind a bus that is what `over_path` makes of it.
    """
    return pid_system(inner, actuator.period_s).then(actuator.scaled(slope))


def closed_ratio(
    inner: Inner, actuator: System, moved: Shift | None, late: System, slope: float, own: System | None = None
) -> System:
    """What other mechanics, delay or slope inside the closed strain loop make of the plant outside: G'/G.

    With PID C and actuator P, the set-point reaches the stage through ``P (F + C) / (1 + P C)`` (F the feedforward)
    and the flexure, whose resonance is P's antiresonance. With another stage and slope g the ratio is

        G'/G = g s (1 + P C) / (1 + g P' C)

    with s the ratio of the sections of P's own mode. `own` is the delay of P (None: none), `late` that of P'. The PID
    has one copy of its states, so that no integrator is left that is only cancelled.
    """
    pid = pid_system(inner, actuator.period_s)
    behind = actuator if moved is None else shifted(actuator, moved)
    ahead = actuator if moved is None else shifted(actuator, moved.poles_only())
    ahead = ahead if own is None else own.then(ahead)
    section = None if moved is None else section_ratio(moved, actuator.period_s)
    back = late.then(behind).scaled(slope)
    sizes = [len(pid.A), len(back.A), len(ahead.A), 0 if section is None else len(section.A)]
    i, j, k, n = np.cumsum(sizes)
    A, B, C = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    # w = u - back(c), c = pid(w), output slope (section(w) + ahead(c)); `back` never feeds through
    A[:i, :i], A[:i, i:j], B[:i] = pid.A, -np.outer(pid.B, back.C), pid.B
    c_from_x = np.concatenate([pid.C, -pid.D * back.C])
    for first, last, block in ((i, j, back), (j, k, ahead)):
        A[first:last, first:last] += block.A
        A[first:last, :j] += np.outer(block.B, c_from_x)
        B[first:last] = block.B * pid.D
    C[j:k] = slope * ahead.C
    direct = slope
    if section is not None:
        A[k:, k:], A[k:, i:j], B[k:] = section.A, -np.outer(section.B, back.C), section.B
        C[k:] = slope * section.C
        direct = slope * section.D
    C[i:j] = -direct * back.C
    return System(A, B, C, direct, actuator.period_s)
