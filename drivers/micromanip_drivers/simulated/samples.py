"""A sample as the driver leaves it in the process image, and seeded noise: xoroshiro128+ and the polar method.

The noise has its whole state in the context.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .records import compiled

_SCALE = 1.0 / 9007199254740992.0


@compiled
def uniform(s: Any) -> float:
    """Uniform in [0, 1), 53 bits."""
    random = s["random"]
    a, b = random[0], random[1]
    total = a + b
    b ^= a
    random[0] = ((a << np.uint64(24)) | (a >> np.uint64(40))) ^ b ^ (b << np.uint64(16))
    random[1] = (b << np.uint64(37)) | (b >> np.uint64(27))
    return float(total >> np.uint64(11)) * _SCALE


@compiled
def normal(s: Any) -> float:
    """Standard normal deviate."""
    if s["has_spare"] != 0:
        s["has_spare"] = 0
        return s["spare"]
    while True:
        u = 2.0 * uniform(s) - 1.0
        v = 2.0 * uniform(s) - 1.0
        q = u * u + v * v
        if 0.0 < q < 1.0:
            break
    factor = math.sqrt(-2.0 * math.log(q) / q)
    s["spare"] = v * factor
    s["has_spare"] = 1
    return u * factor


@compiled
def put(signal: Any, value: float, time_ns: int) -> None:
    """Leave a fresh, good sample."""
    signal["value"] = value
    signal["time_ns"] = time_ns
    signal["sequence"] += 1
    signal["status"] = 0
