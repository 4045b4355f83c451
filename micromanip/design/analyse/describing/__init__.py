"""Describing function of the hysteresis model and its inverse (section 4.6, equations (18)-(24)).

harmonics(inverse_operator(model), amplitude, offset)   # (18)-(21): any shaping, any offset
"""

from .limit_cycles import LimitCycle, limit_cycles
from .operator import actuator_operator, inverse_operator
from .quadrature import harmonics
from .sweep import GainMap, Sweep, Verdict, amplitudes_up_to, branch_slopes, gain_map, judge, sweep

__all__ = [
    "GainMap",
    "LimitCycle",
    "Sweep",
    "Verdict",
    "actuator_operator",
    "amplitudes_up_to",
    "branch_slopes",
    "gain_map",
    "harmonics",
    "inverse_operator",
    "judge",
    "limit_cycles",
    "sweep",
]
