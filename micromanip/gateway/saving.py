"""What is seen on the scope as CSV: every cycle where the rows are still there, else least and greatest of blocks."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import UsageError
from micromanip.recordings.table import table_line

from .cell import Source
from .views import names, number

_LINES = 5000
_ALL = 1 << 40
"""Points: as many as there are."""


def lines(source: Source, told: Mapping[str, Any]) -> AsyncIterator[str]:
    """Text of `fields` from the cycle `first` to `last`; UsageError where that makes no sense."""
    fields = names(told, source)
    first, last = round(number(told, "first", -(2**53), 2**53)), round(number(told, "last", 0, 2**53))
    history = source.history
    if not fields or first > last:
        raise UsageError("saving takes fields, and a first cycle that is not after the last one")
    columns = history.index(fields)
    if first >= history.oldest_full:
        cycles, values = history.whole(columns, first, last)
        named = list(fields)
    else:
        window = history.window(columns, first, last, _ALL)
        cycles, values = window.cycles, np.stack([window.low, window.high], axis=1).reshape(-1, len(window.cycles))
        named = [f"{name} {which}" for name in fields for which in ("least", "greatest")]
    if not len(cycles):
        raise UsageError("nothing is known of these cycles any more")
    return _text(named, cycles, values, source.told["period_ns"] * 1e-9)


async def _text(
    named: list[str], cycles: NDArray[np.int64], values: NDArray[np.float32], period_s: float
) -> AsyncIterator[str]:
    yield f"cycle,time_s,{','.join(named)}\n"
    for begin in range(0, len(cycles), _LINES):
        yield await asyncio.to_thread(
            _rows, cycles[begin : begin + _LINES], values[:, begin : begin + _LINES], period_s
        )


def _rows(cycles: NDArray[np.int64], values: NDArray[np.float32], period_s: float) -> str:
    return "".join(
        f"{cycle},{cycle * period_s:.9g},{table_line(f'{value:.9g}' for value in row)}\n"
        for cycle, row in zip(cycles.tolist(), values.T.tolist(), strict=True)
    )
