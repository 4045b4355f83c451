"""What a simulation knows of one axis beyond its signals: the linear part of its plant, and what disturbs it.

`analyse error` computes from it what each cause does to the path error. A driver that moves something real knows
none of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Line = tuple[float, float]
"""A sine: frequency (Hz) and amplitude."""


@dataclass(frozen=True)
class LinearPlant:
    """``x+ = A x + voltage V + force F + amplifier n`` per period of the loop; A (n, n), the others (n,).

    V is the voltage in force in the period (V), F the force on the stage (N), n the amplifier's own noise (V); gauge
    and stage (um) are ``strain @ x`` and ``stage @ x``. The stack's free displacement is 1 um per V: whoever knows
    its slope scales `voltage` and `amplifier`. A voltage is in force `late_cycles` after that in which it is written.
    """

    A: Array
    voltage: Array
    force: Array
    amplifier: Array
    strain: Array
    stage: Array
    late_cycles: int


@dataclass(frozen=True)
class SimulatedAxis:
    """One axis as the simulation computes it; with the share of creep, `crept`, and without it, `plant`.

    Noise is rms, white from sample to sample; `deviation` is the robot's path deviation as sines (um), `neighbours`
    what the other axes' deviation moves here when they follow it (um), `force_noise` the rms (N) and bandwidth (Hz)
    of first-order noise, `tooth` its sine (N), `hum` that of the gauge (um). Steps are those of converters.
    """

    plant: LinearPlant
    crept: LinearPlant
    deviation: tuple[Line, ...]
    neighbours: tuple[Line, ...]
    tracker_noise_um: float
    force_noise: tuple[float, float]
    tooth: Line
    strain_noise_um: float
    hum: Line
    strain_step_um: float
    stage_noise_um: float
    amplifier_noise_V: float
    voltage_step_V: float
