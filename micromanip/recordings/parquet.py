"""Columns of a Parquet file, each read when it is used; time stamps become seconds from the first one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.extras import required

from .table import Array, Table

_MOST_VALUES = 250_000_000


def read_parquet(file: Path) -> Table:
    """The columns of numbers. CheckFailed where it is cut off, DeviceUnavailable where the extra is missing."""
    with required(f"{file}: reading Parquet", "formats"):
        import pyarrow
        from pyarrow import parquet

    def reading(name: str, stamped: bool) -> Callable[[], Array]:
        def read() -> Array:
            try:
                column = parquet.read_table(file, columns=[name]).column(0)
            except (pyarrow.ArrowException, OSError) as problem:
                raise _damaged(file, problem) from problem
            return _numbers(column, stamped)

        return read

    try:
        with parquet.ParquetFile(file) as opened:
            schema, rows = opened.schema_arrow, opened.metadata.num_rows
    except (pyarrow.ArrowException, OSError) as problem:
        raise _damaged(file, problem) from problem
    if rows > _MOST_VALUES:
        raise CheckFailed(f"{file}: {rows} rows are more than can be read ({_MOST_VALUES}); save a part of it")
    twice = next((name for name in schema.names if schema.names.count(name) > 1), None)
    if twice is not None:
        raise CheckFailed(f"{file}: several of its columns are called {twice}; save it with a name for each")
    kinds = pyarrow.types
    columns: dict[str, Array | Callable[[], Array]] = {}
    units: dict[str, str] = {}
    for field in schema:
        stamped = kinds.is_timestamp(field.type) or kinds.is_duration(field.type)
        plain = kinds.is_integer(field.type) or kinds.is_floating(field.type) or kinds.is_decimal(field.type)
        if stamped or plain:
            columns[field.name] = reading(field.name, stamped)
        if stamped:
            units[field.name] = "s"
        unit = (field.metadata or {}).get(b"unit") or (field.metadata or {}).get(b"units")
        if unit and not stamped:
            units[field.name] = unit.decode("utf-8", "replace")
    if not columns:
        raise CheckFailed(f"{file}: there are no columns of numbers in it; its columns are {', '.join(schema.names)}")
    return Table(file, columns, units)


def _numbers(column: Any, stamped: bool) -> Array:
    values = column.to_numpy() if stamped else column.cast("float64", safe=False).to_numpy()
    if stamped:
        values = (values - values[:1]) / np.timedelta64(1, "s")
    return np.ascontiguousarray(values, dtype=float)


def _damaged(file: Path, problem: Exception) -> CheckFailed:
    return CheckFailed(f"{file}: it is cut off or damaged ({str(problem).splitlines()[0]}); copy it again")
