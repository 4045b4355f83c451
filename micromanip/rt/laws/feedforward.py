"""Feedforward of one axis: the voltage at which the hysteresis model gives the set-point.

The set-point is clipped to the attainable range *before* the inverse: clipping the voltage after it would let the
states of model and actuator drift apart.

Two extensions of (7), both off by default. Creep: the actuator also follows ``sum g_m L_m[u]``, first-order lags of the
plays' input u; the inverse gets the rest of the set-point. Rate dependence: thresholds grow with the speed of u; the
speed is that of the cycle before.

Linear dynamics around the hysteresis, off by default as well: resonances are inverted before the inverse
(``resonance.py``), and the amplifier's first-order lag after it, ``v + lead (v - v_before)``.
"""

from __future__ import annotations

from micromanip.rt.jit import compiled
from micromanip.rt.record import Record, record

from .hysteresis import PLAYS, PLAYS_STATE, admit, inverse_plays, shape, unshape
from .network import NEURONS, NEURONS_STATE, network_output, start_network
from .resonance import RESONANCES, RESONANCES_STATE, start_resonances, without_resonances

NONE, PRANDTL_ISHLINSKII, NETWORK = 0, 1, 2
MAX_CREEP = 8

HYSTERESIS_PARAMETERS = record(
    ("kind", "i8"),
    ("identity", "i8"),
    ("low_um", "f8"),
    ("high_um", "f8"),
    *PLAYS,
    ("rate_cycles", "f8"),
    ("creeps", "i8"),
    ("creep_gain", "f8", (MAX_CREEP,)),
    ("creep_step", "f8", (MAX_CREEP,)),
    *NEURONS,
    *RESONANCES,
    ("lead", "f8"),
)
"""``identity`` is the same for two inverses only where all of their parameters are."""
HYSTERESIS_STATE = record(
    *PLAYS_STATE,
    ("creep_um", "f8", (MAX_CREEP,)),
    ("u_um", "f8"),
    ("change_um", "f8"),
    *NEURONS_STATE,
    *RESONANCES_STATE,
    ("begun", "i8"),
    ("inverse_V", "f8"),
    ("output_V", "f8"),
)


@compiled
def inverse_with_creep(p: Record, s: Record, y: float) -> float:
    """Plays' input u (um) at which hysteresis and creep together give displacement `y`."""
    for m in range(p["creeps"]):
        y -= p["creep_gain"][m] * s["creep_um"][m]
    u = inverse_plays(p, s["z"], y, p["alpha"] * p["rate_cycles"] * abs(s["change_um"]))
    for m in range(p["creeps"]):
        s["creep_um"][m] += p["creep_step"][m] * (u - s["creep_um"][m])
    s["change_um"] = u - s["u_um"]
    s["u_um"] = u
    return u


@compiled
def feedforward_voltage(p: Record, s: Record, setpoint_um: float) -> float:
    """Voltage (V) for `setpoint_um`; 0 without a model (pure feedback, configuration A)."""
    y = max(p["low_um"], min(p["high_um"], setpoint_um))
    if p["resonances"] > 0:
        y = max(p["low_um"], min(p["high_um"], without_resonances(p, s, y)))
    v = 0.0
    if p["kind"] == PRANDTL_ISHLINSKII:
        v = unshape(p["shaping"], inverse_with_creep(p, s, y))
    elif p["kind"] == NETWORK:
        v = network_output(p, s, y)
    if p["lead"] > 0.0:
        before = s["inverse_V"] if s["begun"] != 0 else v
        s["begun"], s["inverse_V"] = 1, v
        v += p["lead"] * (v - before)
    s["output_V"] = v
    return v


@compiled.rare
def start_feedforward(p: Record, s: Record, y_um: float, v: float) -> None:
    """Start at displacement `y_um` and voltage `v`, with a consistent memory, whatever it was."""
    y = max(p["low_um"], min(p["high_um"], y_um))
    start_resonances(p, s, y)
    s["begun"] = 0
    u = shape(p["shaping"], v)
    for m in range(p["creeps"]):
        s["creep_um"][m] = u
        y -= p["creep_gain"][m] * u
    admit(p, s["z"], y)
    s["u_um"] = u
    s["change_um"] = 0.0
    start_network(s, y, v)
