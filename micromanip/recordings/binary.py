"""Columns of binary files: NumPy's and MATLAB's, HDF5 (netCDF's among them) and Parquet.

Vectors, matrices with one signal a column, rows with named fields, and structures of them, whose fields are called
``name.field``: also the "structure with time" of Simulink. What HDF5 and Parquet hold is read when it is used. Python's
objects are never loaded, those of MATLAB (timeseries, table) can't be read without it.
"""

from __future__ import annotations

import contextlib
import warnings
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.extras import required
from micromanip.files import MOST_BYTES

from .table import Array, Table

_WIDE = 10
_OBJECTS = (
    "it holds Python objects, which are never loaded (they may run code): "
    "save plain arrays, numpy.savez(file, t=t, u=u)"
)


def _columns_of(name: str, values: Any) -> Iterator[tuple[str, Array]]:
    """Columns of an array of numbers called `name` (or ""): none where it holds none, or a single number.

    A matrix with far more columns than rows is taken to have one signal a row.
    """
    if values.dtype.names:
        for field in values.dtype.names:
            yield from _columns_of(f"{name}.{field}" if name else field, values[field])
        return
    if values.dtype.kind in "mM":
        values = (values - values.ravel()[:1]) / np.timedelta64(1, "s") if values.size else values.astype(float)
    if values.dtype.kind not in "fiub" or values.ndim == 0 or values.size < 2:
        return
    values = values.reshape([n for n in values.shape if n > 1])
    if values.ndim == 1:
        yield name or "1", np.ascontiguousarray(values, dtype=float)
    elif values.ndim == 2:
        rows = values if values.shape[1] >= _WIDE * values.shape[0] else values.T
        for number, row in enumerate(rows, 1):
            yield f"{name}.{number}" if name else str(number), np.ascontiguousarray(row, dtype=float)


def _table_of(file: Path, arrays: Mapping[str, Any]) -> Table:
    """The columns of several arrays; those of a single one go without its name."""
    columns: dict[str, Array] = {}
    for name, values in arrays.items():
        columns |= dict(_columns_of(name, values))
    if not columns:
        shapes = ", ".join(f"{name or 'the array'}: {values.dtype} {values.shape}" for name, values in arrays.items())
        raise CheckFailed(
            f"{file}: there are no columns of numbers in it ({shapes or 'nothing'}); "
            "what is read are vectors, matrices with one signal a column, and arrays with named fields"
        )
    return Table(file, columns)


def read_npy(file: Path) -> Table:
    """A .npy file. CheckFailed where it is cut off, or holds objects."""
    try:
        values = np.load(file, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError, SyntaxError) as problem:
        raise CheckFailed(f"{file}: {_why(problem)}") from problem
    return _table_of(file, {"": values})


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
            return _table_of(file, {name: arrays[name] for name in arrays.files})
    except (ValueError, OSError, EOFError, SyntaxError, KeyError, zipfile.BadZipFile, zlib.error) as problem:
        raise CheckFailed(f"{file}: {_why(problem)}") from problem


def _why(problem: Exception) -> str:
    if any(word in str(problem) for word in ("pickle", "Object arrays", "Python objects")):
        return _OBJECTS
    why = str(problem).splitlines()[0] if str(problem) else "it ends early"
    return f"it is cut off or damaged ({why}); copy it again"


_TEXTS = ("char", "cell", "function_handle", "struct")
_DEEPEST = 6
_ADVICE = "in MATLAB: save('record.mat', 't', 'u', 'y') with vectors of numbers"
Found = Iterator[tuple[str, Any]]
"""Arrays of numbers by their names; None for an object of MATLAB."""


def read_matlab(file: Path) -> Table:
    """A .mat file of any version. CheckFailed where it is cut off, or holds no numbers."""
    with file.open("rb") as head:
        if head.read(520)[512:] == b"\x89HDF\r\n\x1a\n":
            return read_hdf5(file)
    every = dict(_by_scipy(file))
    found = {name: values for name, values in every.items() if values is not None}
    if not found:
        raise _without_numbers(file, every)
    return _table_of(file, found)


def _without_numbers(file: Path, objects: Collection[str]) -> CheckFailed:
    if objects:
        return CheckFailed(f"{file}: {', '.join(objects)}: an object of MATLAB, which can't be read here; {_ADVICE}")
    return CheckFailed(f"{file}: there are no columns of numbers in it, vectors or tables; {_ADVICE}")


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


_MOST_VALUES = 250_000_000
_UNIT_ATTRIBUTES = ("units", "unit", "Units", "Unit")


@contextlib.contextmanager
def _opened(file: Path) -> Iterator[Any]:
    """The file. CheckFailed for whatever goes wrong while it is read."""
    with required(f"{file}: HDF5", "formats"):
        import h5py
    try:
        with h5py.File(file) as contents:
            yield contents
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as problem:
        why = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
        raise CheckFailed(f"{file}: it is cut off, damaged, or no HDF5 ({why}); copy it again") from problem


def read_hdf5(file: Path) -> Table:
    """The numbers in an HDF5 file, one of MATLAB's too. CheckFailed where it is damaged, or has none."""
    columns: dict[str, Array | Callable[[], Array]] = {}
    units: dict[str, str] = {}
    objects: list[str] = []

    def visit(path: str, item: Any) -> None:
        kind = _text_of(item.attrs.get("MATLAB_class", ""))
        if "MATLAB_object_decode" in item.attrs:
            objects.append(path)
        elif "MATLAB_empty" in item.attrs:
            return
        elif getattr(item, "ndim", 0) > 0 and item.size > 1 and kind not in _TEXTS and not path.startswith("#"):
            name, stated = path.replace("/", "."), _stated_unit(item.attrs)
            shape = _few(item.shape[::-1] if kind else item.shape)  # MATLAB's arrays lie the other way round
            for found, _ in _columns_of(name, np.zeros(shape, item.dtype)):
                columns[found] = _reading(file, path, name, found, turned=bool(kind))
                if stated:
                    units[found] = stated

    with _opened(file) as contents:
        contents.visititems(visit)
    if not columns:
        raise _without_numbers(file, objects)
    return Table(file, columns, units)


def _stated_unit(attributes: Any) -> str:
    """The unit, "" without one; a text or an array of one, and "ms" of netCDF's "ms since 2026-11-24"."""
    stated = next((attributes[name] for name in _UNIT_ATTRIBUTES if name in attributes), "")
    stated = stated.item() if isinstance(stated, np.ndarray) and stated.size == 1 else stated
    return _text_of(stated).partition(" since ")[0]


def _text_of(attribute: Any) -> str:
    text = attribute.decode() if isinstance(attribute, bytes) else attribute
    return text if isinstance(text, str) else ""


def _few(shape: tuple[int, ...]) -> tuple[int, ...]:
    """A small array's shape with the same columns: what they are called can be tried on it."""
    if len(shape) != 2:
        return tuple(min(n, 2) for n in shape)
    rows, columns = shape
    return (rows, _WIDE * rows) if columns >= _WIDE * rows else (max(2, min(shape)), columns)


def _reading(file: Path, path: str, name: str, column: str, *, turned: bool) -> Callable[[], Array]:
    def read() -> Array:
        with _opened(file) as contents:
            item = contents[path]
            if item.size > _MOST_VALUES:
                raise CheckFailed(f"{file}: {path} has {item.size} values, more than can be read ({_MOST_VALUES})")
            for source in item.virtual_sources() if item.is_virtual else ():  # zeros where they are not there
                if source.file_name != "." and not (file.parent / source.file_name).exists():
                    raise CheckFailed(f"{file}: {path} is kept in {source.file_name}, which is not there; copy it, too")
            values = _unpacked(item[()], item.attrs)
            return dict(_columns_of(name, values.T if turned else values))[column]

    return read


def _unpacked(values: Any, attributes: Any) -> Any:
    """Values as netCDF means them: packed into few bits by a factor and an offset, NaN where there is none."""
    factor, offset = attributes.get("scale_factor"), attributes.get("add_offset")
    fills = [np.ravel(attributes[name]) for name in ("_FillValue", "missing_value") if name in attributes]
    if values.dtype.kind not in "fiu" or (factor is None and offset is None and not fills):
        return values
    scaled = values * np.float64(1.0 if factor is None else np.ravel(factor)[0])
    scaled = scaled + np.float64(0.0 if offset is None else np.ravel(offset)[0])
    return np.where(np.isin(values, np.concatenate(fills)), np.nan, scaled) if fills else scaled
