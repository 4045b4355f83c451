"""Sums of the laws, which the compiler would not vectorise: it may not reorder them, and checks each index.

These are the definitions in plain Python. Compiled code uses ``vectors.py``: the same sums in the same order, equal to
the last bit.
"""

from __future__ import annotations

from typing import Any

LANES = 4
"""Terms that machine code sums side by side."""
ROWS_AT_ONCE = 16
"""Rows of a matrix that it sums at once: its columns stand in blocks of so many rows."""


def advance_model(blocks: Any, b: Any, u: float, x: Any, scratch: Any, count: int) -> None:
    """``x <- A x + B u`` of `count` states; what lies behind them in `x` and `scratch` may be written as well."""
    for i in range(count):
        scratch[i] = b[i] * u
    for j in range(count):
        for i in range(count):
            scratch[i] += blocks[i // ROWS_AT_ONCE, j, i % ROWS_AT_ONCE] * x[j]
    x[:count] = scratch[:count]


def weighted(weights: Any, x: Any, count: int) -> float:
    """The sum of `count` elements of `x` by their weights: `LANES` of them side by side, then those that are left."""
    lane = [0.0] * LANES
    whole = count // LANES * LANES
    for i in range(whole):
        lane[i % LANES] += weights[i] * x[i]
    total = (lane[0] + lane[2]) + (lane[1] + lane[3])
    for i in range(whole, count):
        total += weights[i] * x[i]
    return total


def correct(expected: Any, gain: Any, innovation: float, filtered: Any, x: Any, count: int) -> None:
    """``filtered = x = expected + gain innovation`` of `count` states, and of what fills the last `LANES` of them."""
    for i in range(-(-count // LANES) * LANES):
        filtered[i] = x[i] = expected[i] + gain[i] * innovation
