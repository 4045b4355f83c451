"""What another voltage than the recorded one would have done to an axis, cycle by cycle.

All that was measured stays in: forces, noise, path, whatever no model knows. Only differences to it are simulated,

    d_free   = H[V] - H[V_recorded]              hysteresis of the recording's own model
    d_strain = P(z) d_free                       actuator, as fitted to the recording (`fitting`)
    d_stage  = M(z) d_setpoint                   stage, the recording's own model of set-point to stage

and added to what the sensors said. M was identified with the strain loop of the recording closed. So it is given the
set-point at which *that* loop would have moved the actuator as the other tuning does: its PID C (in um of free
displacement per um) and feedforward f, 1 or 0, solved for the set-point,

    d_free = f d_setpoint + C(z) (d_setpoint - d_strain)

Where only the outer loop is another one, that is the set-point itself. With equal voltages every difference is
exactly 0.
"""

from __future__ import annotations

from typing import Any

from micromanip.rt.jit import Compiler
from micromanip.rt.laws.estimator import INPUT_HISTORY, MAX_STATES
from micromanip.rt.laws.hysteresis import MAX_PLAYS, PLAYS, model_output
from micromanip.rt.record import MAX_AXES, Record, record

ORDER = 12
"""Cycles that the actuator's model looks back."""
PID_STATES = 5

PLAYS_MODEL = record(*PLAYS)
DIFFERENCE_MODEL = record(
    ("present", "i8"),
    ("hysteresis", PLAYS_MODEL),
    ("strain", "f8", (ORDER,)),
    ("free", "f8", (ORDER,)),
    ("feedforward", "f8"),
    ("pid_A", "f8", (PID_STATES, PID_STATES)),
    ("pid_B", "f8", (PID_STATES,)),
    ("pid_C", "f8", (PID_STATES,)),
    ("pid_D", "f8"),
    ("states", "i8"),
    ("A", "f8", (MAX_STATES, MAX_STATES)),
    ("B", "f8", (MAX_STATES,)),
    ("C", "f8", (MAX_STATES,)),
    ("delay", "i8"),
    ("coupling", "f8", (MAX_AXES,)),
)
"""``present`` 0: nothing differs. ``strain``, ``free``: P, weights of its past and of what came in, newest first;
``coupling``: how much each axis moves along this one, 1 for itself."""
DIFFERENCE_STATE = record(
    ("plays", "f8", (MAX_PLAYS,)),
    ("free_um", "f8", (ORDER,)),
    ("strain_um", "f8", (ORDER,)),
    ("pid", "f8", (PID_STATES,)),
    ("x", "f8", (MAX_STATES,)),
    ("scratch", "f8", (MAX_STATES,)),
    ("cycle", "i8"),
    ("setpoints", "f8", (INPUT_HISTORY,)),
    ("strains", "f8", (INPUT_HISTORY,)),
    ("stages", "f8", (INPUT_HISTORY,)),
)
"""``free_um``, ``strain_um``: the differences of the last cycles, newest first; the rings hold one value per cycle."""

_MASK = INPUT_HISTORY - 1

compiled = Compiler(__file__)


@compiled
def advance_difference(m: Record, s: Record) -> None:
    """One cycle on, with what was given in the one before."""
    now, free, strain = s["cycle"] + 1, s["free_um"], s["strain_um"]
    total = 0.0
    for k in range(ORDER):
        total += m["strain"][k] * strain[k] + m["free"][k] * free[k]
    for k in range(ORDER - 1, 0, -1):
        strain[k] = strain[k - 1]
        free[k] = free[k - 1]
    strain[0] = total
    u, x, scratch = s["setpoints"][(now - 1 - m["delay"]) & _MASK], s["x"], s["scratch"]
    stage = 0.0
    for i in range(m["states"]):
        moved = m["B"][i] * u
        for j in range(m["states"]):
            moved += m["A"][i, j] * x[j]
        scratch[i] = moved
        stage += m["C"][i] * moved
    for i in range(m["states"]):
        x[i] = scratch[i]
    s["strains"][now & _MASK], s["stages"][now & _MASK] = total, stage
    s["setpoints"][now & _MASK] = s["setpoints"][(now - 1) & _MASK]
    s["cycle"] = now


@compiled
def give_voltage(m: Record, s: Record, voltage_V: float, recorded_um: float) -> None:
    """The voltage that the present cycle ends with, and the free displacement under the recorded one."""
    s["free_um"][0] = model_output(m["hysteresis"], s["plays"], voltage_V) - recorded_um
    give_setpoint(m, s)


@compiled
def give_setpoint(m: Record, s: Record) -> None:
    """The recorded loop's set-point for what the voltages differ by, where the strain is now.

    Also in a cycle that was missed: the voltages stay, but the strain goes on, and so would that loop.
    """
    free, pid, within, strain = s["free_um"][0], s["pid"], 0.0, s["strain_um"][0]
    for i in range(PID_STATES):
        within += m["pid_C"][i] * pid[i]
    setpoint = (free - within + m["pid_D"] * strain) / (m["feedforward"] + m["pid_D"])
    error, scratch = setpoint - strain, s["scratch"]
    for i in range(PID_STATES):
        moved = m["pid_B"][i] * error
        for j in range(PID_STATES):
            moved += m["pid_A"][i, j] * pid[j]
        scratch[i] = moved
    for i in range(PID_STATES):
        pid[i] = scratch[i]
    s["setpoints"][s["cycle"] & _MASK] = setpoint


@compiled
def cycles_ago(age_ns: int, period_ns: int) -> int:
    """Cycles since a sample was taken; those of the oldest that is remembered where it is older."""
    return max(0, min(_MASK, (age_ns + period_ns // 2) // period_ns))


@compiled
def at_age(ring: Any, s: Record, cycles: int) -> float:
    """The difference of `cycles` ago."""
    difference: float = ring[(s["cycle"] - cycles) & _MASK]
    return difference
