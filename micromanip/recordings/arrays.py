"""Columns of NumPy's .npy and .npz, and of any array: a vector, a matrix, or rows with named fields."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.files import MOST_BYTES

from .table import Array, Table

WIDE = 10
_OBJECTS = (
    "it holds Python objects, which are never loaded (they may run code): "
    "save plain arrays, numpy.savez(file, t=t, u=u)"
)


def columns_of(name: str, values: Any) -> Iterator[tuple[str, Array]]:
    """Columns of an array of numbers called `name` (or ""): none where it holds none, or a single number.

    A matrix with far more columns than rows is taken to have one signal a row.
    """
    if values.dtype.names:
        for field in values.dtype.names:
            yield from columns_of(f"{name}.{field}" if name else field, values[field])
        return
    if values.dtype.kind in "mM":
        values = (values - values.ravel()[:1]) / np.timedelta64(1, "s") if values.size else values.astype(float)
    if values.dtype.kind not in "fiub" or values.ndim == 0 or values.size < 2:
        return
    values = values.reshape([n for n in values.shape if n > 1])
    if values.ndim == 1:
        yield name or "1", np.ascontiguousarray(values, dtype=float)
    elif values.ndim == 2:
        rows = values if values.shape[1] >= WIDE * values.shape[0] else values.T
        for number, row in enumerate(rows, 1):
            yield f"{name}.{number}" if name else str(number), np.ascontiguousarray(row, dtype=float)


def table_of(file: Path, arrays: Mapping[str, Any], units: Mapping[str, str] | None = None) -> Table:
    """The columns of several arrays; those of a single one go without its name."""
    columns: dict[str, Array] = {}
    for name, values in arrays.items():
        columns |= dict(columns_of(name, values))
    if not columns:
        shapes = ", ".join(f"{name or 'the array'}: {values.dtype} {values.shape}" for name, values in arrays.items())
        raise CheckFailed(
            f"{file}: there are no columns of numbers in it ({shapes or 'nothing'}); "
            "what is read are vectors, matrices with one signal a column, and arrays with named fields"
        )
    return Table(file, columns, units)


def read_npy(file: Path) -> Table:
    """A .npy file. CheckFailed where it is cut off, or holds objects."""
    try:
        values = np.load(file, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError, SyntaxError) as problem:
        raise CheckFailed(f"{file}: {_why(problem)}") from problem
    return table_of(file, {"": values})


def read_npz(file: Path) -> Table:
    """A .npz file. CheckFailed where it is cut off, holds objects, or is another archive."""
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            if not all(member.filename.endswith(".npy") for member in members):
                raise CheckFailed(f"{file}: this is an archive or an Excel workbook: unpack it, or save it as CSV")
            if sum(member.file_size for member in members) > MOST_BYTES:
                raise CheckFailed(f"{file}: unpacked it is larger than {MOST_BYTES / 1e6:g} MB; save a part of it")
        with np.load(file, allow_pickle=False) as arrays:
            return table_of(file, {name: arrays[name] for name in arrays.files})
    except (ValueError, OSError, EOFError, SyntaxError, KeyError, zipfile.BadZipFile, zlib.error) as problem:
        raise CheckFailed(f"{file}: {_why(problem)}") from problem


def _why(problem: Exception) -> str:
    if any(word in str(problem) for word in ("pickle", "Object arrays", "Python objects")):
        return _OBJECTS
    why = str(problem).splitlines()[0] if str(problem) else "it ends early"
    return f"it is cut off or damaged ({why}); copy it again"
