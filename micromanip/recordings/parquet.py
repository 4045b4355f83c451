"""Columns of a Parquet file, each read when it is used; time stamps become seconds from the first one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.extras import required

from .table import Array, Table


def read_parquet(file: Path) -> Table:
    """The columns of numbers. CheckFailed where it is cut off, DeviceUnavailable where the extra is missing."""
    with required(f"{file}: Parquet", "formats"):
        import pyarrow
        from pyarrow import parquet

    def of_file(read: Callable[[], Any]) -> Any:
        try:
            return read()
        except (pyarrow.ArrowException, OSError) as problem:
            why = str(problem).splitlines()[0]
            raise CheckFailed(f"{file}: it is cut off or damaged ({why}); copy it again") from problem

    def reading(name: str, stamped: bool) -> Callable[[], Array]:
        def read() -> Array:
            column = of_file(lambda: parquet.read_table(file, columns=[name])).column(0)
            if stamped:
                stamps = column.to_numpy()
                return np.asarray((stamps - stamps[:1]) / np.timedelta64(1, "s"), float)
            return np.ascontiguousarray(column.cast("float64", safe=False).to_numpy(), float)

        return read

    schema = of_file(lambda: parquet.read_schema(file))
    twice = next((name for name in schema.names if schema.names.count(name) > 1), None)
    if twice is not None:
        raise CheckFailed(f"{file}: several of its columns are called {twice}; save it with a name for each")
    kinds = pyarrow.types
    columns: dict[str, Array | Callable[[], Array]] = {}
    units: dict[str, str] = {}
    for field in schema:
        stamped = kinds.is_timestamp(field.type) or kinds.is_duration(field.type)
        if stamped or kinds.is_integer(field.type) or kinds.is_floating(field.type) or kinds.is_decimal(field.type):
            columns[field.name] = reading(field.name, stamped)
            units[field.name] = "s" if stamped else (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
    if not columns:
        raise CheckFailed(f"{file}: there are no columns of numbers in it; its columns are {', '.join(schema.names)}")
    return Table(file, columns, units)
