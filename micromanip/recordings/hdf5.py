"""Columns of HDF5: our own recordings, by parts, and files of others: vectors, matrices, tables, with units."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.extras import required

from .arrays import WIDE, columns_of
from .table import Array, Table
from .telemetry import Piece, Telemetry

ENDINGS = (".h5", ".hdf5")
_PART_ROWS, _PIECE_ROWS = 50_000, 4096
_MOST_VALUES = 250_000_000
_SUPERBLOCK = struct.Struct("<8xBxxB16xQ")
"""Version, flags, and where the file ends, in the version that has flags."""
_WITH_FLAGS, _WRITTEN_AND_READ = 3, 4
_UNIT_ATTRIBUTES = ("units", "unit", "Units", "Unit")


def require_h5py(file: Path) -> Any:
    """The library. DeviceUnavailable where it is not installed."""
    with required(f"{file}: reading HDF5", "formats"):
        import h5py
    return h5py


@contextlib.contextmanager
def opened(file: Path) -> Iterator[Any]:
    """The file, also a recording of ours whose recorder and host were killed: it is complete up to a flush.

    CheckFailed for whatever goes wrong while it is read.
    """
    h5py = require_h5py(file)
    try:
        with h5py.File(file, swmr=_was_left_open(file)) as contents:
            yield contents
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as problem:
        why = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
        raise CheckFailed(f"{file}: it is cut off, damaged, or no HDF5 ({why}); copy it again") from problem


def _was_left_open(file: Path) -> bool:
    """Whether its writer, one that lets others read meanwhile, has not closed it, and all that it tells of is there.

    Only such a file is read as one that is being written: where a piece is missing, HDF5 waits for it without end.
    """
    with file.open("rb") as stream:
        head = stream.read(_SUPERBLOCK.size)
    if len(head) < _SUPERBLOCK.size:
        return False
    version, flags, end = _SUPERBLOCK.unpack(head)
    return version == _WITH_FLAGS and bool(flags & _WRITTEN_AND_READ) and end <= file.stat().st_size


def read_hdf5(file: Path) -> Table:
    """A recording of `run --record`, or the numbers in any other HDF5 file, each column read when it is used."""
    with opened(file) as contents:
        return _ours(file, contents).table() if _is_ours(contents) else _others(file, contents)


def _is_ours(contents: Any) -> bool:
    return "rows" in contents and "period_ns" in contents.attrs and "cycle" in (contents["rows"].dtype.names or ())


def is_telemetry(file: Path) -> bool:
    """Whether it is an HDF5 file of ours. CheckFailed where it can't be read."""
    with opened(file) as contents:
        return _is_ours(contents)


def open_hdf5(file: Path) -> Telemetry:
    """What a recording of ours is of; its rows are read later. CheckFailed where it is damaged."""
    with opened(file) as contents:
        return _ours(file, contents)


def _ours(file: Path, contents: Any) -> Telemetry:
    attributes = contents.attrs
    problem = attributes.get("problem", b"")
    end = {"lost": int(attributes.get("lost", 0)), "complete": bool(attributes.get("complete", False))}
    return Telemetry(
        file,
        axes=list(attributes["axes"]),
        period_ns=int(attributes["period_ns"]),
        dtype=contents["rows"].dtype,
        configuration=str(attributes.get("configuration", "")),
        sha256=str(attributes.get("sha256", "")),
        end={**end, "rows": len(contents["rows"]), "problem": problem.decode() if isinstance(problem, bytes) else ""},
        parts=partial(_parts, file),
        rows=partial(_rows, file),
        pieces=partial(_pieces, file),
        state=contents["state"][()] if "state" in contents else None,
        parameters=[one[None] for one in contents["parameters"][()]] if "parameters" in contents else (),
        states=[one[None] for one in contents["states"][()]] if "states" in contents else (),
        samples=contents["samples"][()] if "samples" in contents else None,
        sources=str(attributes.get("sources", "")),
    )


def _rows(file: Path, count: int = _PART_ROWS) -> Iterator[Any]:
    with opened(file) as contents:
        rows = contents["rows"]
        for first in range(0, len(rows), count):
            yield rows[first : first + count]


def _pieces(file: Path) -> list[Piece]:
    with opened(file) as contents:
        count = len(contents["rows"])
    return [partial(_piece, file, first) for first in range(0, count, _PIECE_ROWS)]


def _piece(file: Path, first: int, paths: Sequence[str]) -> dict[str, Any]:
    with opened(file) as contents:
        rows = contents["rows"][first : first + _PIECE_ROWS]
    return {path: _at(rows, path) for path in paths}


def _parts(file: Path, paths: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Columns of a long dataset, without ever holding all of it."""
    for rows in _rows(file):
        yield {path: _at(rows, path) for path in paths}


def _at(rows: Any, path: str) -> Any:
    name, _, rest = path.partition(".")
    place, _, field = rest.partition(".")
    return np.ascontiguousarray(rows[name][field][:, int(place)] if rest else rows[name])


def _others(file: Path, contents: Any) -> Table:
    columns: dict[str, Array | Callable[[], Array]] = {}
    units: dict[str, str] = {}
    h5py = require_h5py(file)

    def visit(path: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or item.ndim == 0 or item.size < 2:
            return
        stated = _stated_unit(item.attrs)
        name = path.replace("/", ".")
        for found, _ in columns_of(name, np.zeros(_few(item.shape), item.dtype)):
            columns[found] = _reading(file, path, name, found)
            if stated:
                units[found] = stated

    contents.visititems(visit)
    if not columns:
        raise CheckFailed(f"{file}: there are no columns of numbers in it, vectors or tables")
    return Table(file, columns, units)


def _stated_unit(attributes: Any) -> str:
    """The unit, "" without one; a text or an array of one, and "ms" of netCDF's "ms since 2026-11-24"."""
    stated = next((attributes[name] for name in _UNIT_ATTRIBUTES if name in attributes), "")
    stated = stated.item() if isinstance(stated, np.ndarray) and stated.size == 1 else stated
    stated = stated.decode() if isinstance(stated, bytes) else stated
    return stated.partition(" since ")[0] if isinstance(stated, str) else ""


def _require_readable(file: Path, item: Any) -> None:
    """CheckFailed where the library would say nothing useful, or give zeros for what is not there."""
    h5py = require_h5py(file)
    filters = item.id.get_create_plist()
    for code, _, _, name in (filters.get_filter(k) for k in range(filters.get_nfilters())):
        if not h5py.h5z.filter_avail(code):
            called = f" ({name.decode(errors='replace')})" if name else ""
            raise CheckFailed(
                f"{file}: {item.name} is compressed by HDF5 filter {code}{called}, which is not installed here; "
                "save it with gzip, or not compressed"
            )
    for source in item.virtual_sources() if item.is_virtual else ():
        if source.file_name != "." and not (file.parent / source.file_name).exists():
            raise CheckFailed(f"{file}: {item.name} is kept in {source.file_name}, which is not there; copy it, too")


def _unpacked(values: Any, attributes: Any) -> Any:
    """Values as netCDF means them: packed into few bits by a factor and an offset, NaN where there is none."""
    factor, offset = attributes.get("scale_factor"), attributes.get("add_offset")
    fills = [attributes[name] for name in ("_FillValue", "missing_value") if name in attributes]
    if values.dtype.kind not in "fiu" or (factor is None and offset is None and not fills):
        return values
    missing = (
        np.isin(values, np.concatenate([np.ravel(fill) for fill in fills])) if fills else np.zeros(values.shape, bool)
    )
    scaled = values * np.float64(1.0 if factor is None else np.ravel(factor)[0])
    return np.where(missing, np.nan, scaled + np.float64(0.0 if offset is None else np.ravel(offset)[0]))


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
            _require_readable(file, item)
            return dict(columns_of(name, _unpacked(item[()], item.attrs)))[column]

    return read
