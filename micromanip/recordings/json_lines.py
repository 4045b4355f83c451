"""Columns of JSON: an object a line, an array of objects, or an object of arrays; ``amp.u`` is u within amp."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.files import open_regular

from .arrays import table_of
from .table import Table
from .text import stamp_s


def read_json(file: Path) -> Table:
    """A column for each name whose values are numbers, NaN in objects without it. CheckFailed, with the line."""
    with open_regular(file) as opened:
        text = opened.read().decode("utf-8-sig", errors="replace")
    lines: list[int] | None = None
    try:
        found = json.loads(text)
    except ValueError:
        found, lines = [], []
        for number, line in enumerate(text.splitlines(), 1):
            if not line.strip():
                continue
            try:
                found.append(json.loads(line))
            except ValueError as problem:
                raise CheckFailed(f"{file}:{number}: no JSON, {problem}: the line may be cut off, remove it") from None
            lines.append(number)
    if isinstance(found, dict):
        return table_of(file, {name: np.asarray(each) for name, each in _flat(found) if _are_numbers(each)})
    rows = [dict(_flat(each)) if isinstance(each, dict) else {} for each in found]
    units = {name: "s" for row in rows[:1] for name, value in row.items() if _stamp(value) is not None}
    of = {name: _stamp if name in units else _number for row in rows for name in row}
    read = {name: np.array([how(row.get(name)) for row in rows], dtype=float) for name, how in of.items()}
    columns = {name: each - each[0] if name in units else each for name, each in read.items()}
    numbers = {name: each for name, each in columns.items() if np.isfinite(each).any()}
    return Table(file, table_of(file, numbers), units, lines)


def _flat(found: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in found.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _stamp(value: Any) -> float | None:
    return stamp_s(value) if isinstance(value, str) else None


def _are_numbers(values: Any) -> bool:
    return isinstance(values, list) and all(_number(each) is not None for each in values)
