"""The simulated amplifier discharged with the loop dead: compiled for the loop's process, plain Python in the host.

A step would ring the flexure, so it takes 0.2 s. A stall draws it out, and makes no step either.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.driver import minimum_jerk

from .compiled import compiled
from .records import CONTEXT

DISCHARGE_STEPS, DISCHARGE_STEP_NS = 200, 1_000_000


@compiled
def begin_discharge(c: Any) -> int:
    """Note the voltages it begins from; the number of steps that are over, all of them where nothing is charged."""
    charged = False
    for i in range(c["axes"]):
        s = c["s"][i]
        s["charged_V"] = s["latched_V"]
        charged = charged or s["charged_V"] != 0.0
    return 0 if charged else DISCHARGE_STEPS


@compiled
def discharge_to(c: Any, step: int) -> None:
    """Every voltage to where it is after so many steps."""
    for i in range(c["axes"]):
        s = c["s"][i]
        s["latched_V"] = s["charged_V"] * (1.0 - minimum_jerk(step / DISCHARGE_STEPS))


@compiled
def end_discharge(c: Any) -> None:
    """Switch the amplifier off, noted for whoever looks."""
    c["lines"]["amplifier_enable"] = 0
    c["safe"] = 1


def discharge_in_host(context: NDArray[np.uint8]) -> int:
    """The whole of it, on a context in shared memory; always 0."""
    c = context.view(CONTEXT)[0]
    for step in range(begin_discharge(c) + 1, DISCHARGE_STEPS + 1):
        discharge_to(c, step)
        time.sleep(DISCHARGE_STEP_NS * 1e-9)
    end_discharge(c)
    return 0
