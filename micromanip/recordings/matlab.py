"""Columns of MATLAB files: up to version 7.2 by scipy, 7.3 (which is HDF5) by h5py.

Vectors, matrices with one signal a column, and structures of them, whose fields are called ``name.field``: also the
"structure with time" of Simulink. Objects (timeseries, table) can't be read without MATLAB.
"""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed

from .arrays import table_of
from .hdf5 import opened
from .table import Table

_TEXTS = ("char", "cell", "function_handle", "struct")
_DEEPEST = 6
_ADVICE = "in MATLAB: save('record.mat', 't', 'u', 'y') with vectors of numbers"
Found = Iterator[tuple[str, Any]]
"""Arrays of numbers by their names; None for an object of MATLAB."""


def read_matlab(file: Path) -> Table:
    """A .mat file of any version. CheckFailed where it is cut off, or holds no numbers."""
    with file.open("rb") as head:
        is_hdf5 = head.read(520)[512:] == b"\x89HDF\r\n\x1a\n"
    every = dict(_of_hdf5(file) if is_hdf5 else _by_scipy(file))
    found = {name: values for name, values in every.items() if values is not None}
    if not found and every:
        raise CheckFailed(f"{file}: {', '.join(every)}: an object of MATLAB, which can't be read here; {_ADVICE}")
    if not found:
        raise CheckFailed(f"{file}: there are no columns of numbers in it; {_ADVICE}")
    return table_of(file, found)


def _by_scipy(file: Path) -> Found:
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabFunction, MatlabOpaque, MatReadError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about objects, which are told above
            variables = loadmat(file, struct_as_record=True, verify_compressed_data_integrity=True)
    except (
        MatReadError, ValueError, OSError, EOFError, TypeError, KeyError, IndexError, NotImplementedError, zlib.error
    ) as problem:  # fmt: skip
        raise CheckFailed(f"{file}: no MATLAB file, or cut off ({problem}); save it again, {_ADVICE}") from problem
    for name, value in variables.items():
        if isinstance(value, MatlabOpaque | MatlabFunction):
            yield name if name != "None" else "a variable", None
        elif isinstance(value, np.ndarray) and not name.startswith("__"):
            yield from _flat(name, value, _DEEPEST)


def _flat(name: str, value: Any, deeper: int) -> Found:
    """Arrays of numbers in a variable, through structures (arrays of objects with fields)."""
    if value.dtype.names and deeper:
        for k, one in enumerate(value.ravel(), 1):
            several = f"{name}({k})" if value.size > 1 else name
            for field in value.dtype.names:
                if isinstance(one[field], np.ndarray):
                    yield from _flat(f"{several}.{field}", one[field], deeper - 1)
    elif value.dtype.kind in "fiub" and value.size > 1:
        yield name, value


def _of_hdf5(file: Path) -> Found:
    found: list[tuple[str, Any]] = []

    def visit(name: str, item: Any) -> None:
        kind = item.attrs.get("MATLAB_class", b"")
        kind = kind.decode() if isinstance(kind, bytes) else str(kind)
        if name.startswith("#") or "MATLAB_empty" in item.attrs:
            return
        if "MATLAB_object_decode" in item.attrs:
            found.append((name, None))
        elif getattr(item, "size", 0) > 1 and kind not in _TEXTS and item.dtype.kind in "fiu":
            found.append((name.replace("/", "."), np.asarray(item[()]).T))  # MATLAB's arrays lie the other way round

    with opened(file) as contents:
        contents.visititems(visit)
    return iter(found)
