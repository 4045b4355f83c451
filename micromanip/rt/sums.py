"""Sums of the laws that the compiler would make one by one: it may not reorder them, and looks at each index.

These are the definitions, and plain Python. Compiled code has ``vectors.py`` for them: the same sums in the same order,
to the last bit.
"""

from __future__ import annotations

from typing import Any

ROWS_AT_ONCE = 16
"""Rows of a matrix that machine code sums at once: arrays have a multiple of that."""


def advance_model(a_columns: Any, b: Any, u: float, x: Any, scratch: Any, count: int) -> None:
    """``x <- A x + B u`` of `count` states; what lies behind them in `x` and `scratch` may be written as well."""
    for i in range(count):
        scratch[i] = b[i] * u
    for j in range(count):
        for i in range(count):
            scratch[i] += a_columns[j, i] * x[j]
    x[:count] = scratch[:count]


def weighted(total: float, weights: Any, x: Any, count: int) -> float:
    """`total` and, one after the other, `count` elements of `x` by their weights."""
    for i in range(count):
        total += weights[i] * x[i]
    return total
