"""Columns of HDF5: our own recordings, by parts, and files of others: vectors, matrices, tables, with units."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed

from .arrays import WIDE, columns_of
from .table import Array, Table

_PART_ROWS = 50_000
_MOST_VALUES = 250_000_000
_UNIT_ATTRIBUTES = ("units", "unit", "Units", "Unit")


def require_h5py(file: Path) -> Any:
    """The library. CheckFailed where it is not installed."""
    try:
        import h5py
    except ImportError as problem:
        raise CheckFailed(f"{file}: reading HDF5 needs the extra: pip install micromanip[recording]") from problem
    return h5py


@contextlib.contextmanager
def opened(file: Path) -> Iterator[Any]:
    """The file, also a recording of ours whose recorder and host were killed: it is complete up to a flush.

    CheckFailed for whatever goes wrong while it is read.
    """
    h5py = require_h5py(file)
    try:
        try:
            contents = h5py.File(file)
        except OSError:
            contents = h5py.File(file, swmr=True)
        with contents:
            yield contents
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as problem:
        why = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
        raise CheckFailed(f"{file}: it is cut off, damaged, or no HDF5 ({why}); copy it again") from problem


def read_hdf5(file: Path) -> Table:
    """A recording of `run --record`, or the numbers in any other HDF5 file, each column read when it is used."""
    with opened(file) as contents:
        return _ours(file, contents) if _is_ours(contents) else _others(file, contents)


def _is_ours(contents: Any) -> bool:
    return "rows" in contents and "period_ns" in contents.attrs and "cycle" in (contents["rows"].dtype.names or ())


def _ours(file: Path, contents: Any) -> Table:
    """Columns ``t_s``, by the counter of cycles so that a skipped one shows, and ``field_axis``."""
    axes, step_s = list(contents.attrs["axes"]), float(contents.attrs["period_ns"]) * 1e-9

    def column(field: str, place: int) -> Callable[[], Array]:
        return lambda: _parts(file, "rows", lambda rows: rows["axis"][field][:, place])

    def time() -> Array:
        cycles = _parts(file, "rows", lambda rows: rows["cycle"])
        return (cycles - cycles[:1]) * step_s

    columns: dict[str, Array | Callable[[], Array]] = {"t_s": time}
    for place, axis in enumerate(axes):
        for field in contents["rows"].dtype["axis"].base.names or ():
            columns[f"{field}_{axis}"] = column(field, place)
    return Table(file, columns)


def _parts(file: Path, path: str, pick: Callable[[Any], Any]) -> Array:
    """One column of a long dataset, without ever holding all of it."""
    with opened(file) as contents:
        rows = contents[path]
        if len(rows) > _MOST_VALUES:
            raise CheckFailed(f"{file}: {len(rows)} rows are more than can be read ({_MOST_VALUES}); export a part")
        whole = np.empty(len(rows))
        for first in range(0, len(rows), _PART_ROWS):
            part = slice(first, first + _PART_ROWS)
            whole[part] = pick(rows[part])
        return whole


def _others(file: Path, contents: Any) -> Table:
    columns: dict[str, Array | Callable[[], Array]] = {}
    units: dict[str, str] = {}
    h5py = require_h5py(file)

    def visit(path: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or item.ndim == 0 or item.size < 2:
            return
        stated = next((item.attrs[name] for name in _UNIT_ATTRIBUTES if name in item.attrs), None)
        name = path.replace("/", ".")
        for found, _ in columns_of(name, np.zeros(_few(item.shape), item.dtype)):
            columns[found] = _reading(file, path, name, found)
            if isinstance(stated, bytes | str):
                units[found] = stated.decode() if isinstance(stated, bytes) else stated

    contents.visititems(visit)
    if not columns:
        raise CheckFailed(f"{file}: there are no columns of numbers in it, vectors or tables")
    return Table(file, columns, units)


def _few(shape: tuple[int, ...]) -> tuple[int, ...]:
    """A small array's shape with the same columns: what they are called can be tried on it."""
    if len(shape) != 2:
        return tuple(min(n, 2) for n in shape)
    rows, columns = shape
    return (rows, WIDE * rows) if columns >= WIDE * rows else (max(2, min(shape)), columns)


def _reading(file: Path, path: str, name: str, column: str) -> Callable[[], Array]:
    def read() -> Array:
        with opened(file) as contents:
            item = contents[path]
            if item.size > _MOST_VALUES:
                raise CheckFailed(f"{file}: {path} has {item.size} values, more than can be read ({_MOST_VALUES})")
            return dict(columns_of(name, item[()]))[column]

    return read
