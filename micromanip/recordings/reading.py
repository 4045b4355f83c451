"""A file by what it holds, not by what it is called: one reader for each kind, one message for what can't be read."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.files import open_regular

from .arrays import read_npy, read_npz, table_of
from .hdf5 import read_hdf5, read_matlab, read_parquet
from .mcap_reading import MAGIC, open_mcap, read_mcap
from .table import Table
from .telemetry import Telemetry
from .text import read_text, stamp_s


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


KINDS = "CSV or other text, JSON, .mat, .npy, .npz, MCAP, HDF5 or Parquet"
_HDF5 = b"\x89HDF\r\n\x1a\n"
_PARTS = 1_000_000_000_000
"""Bytes of a file whose columns are read on their own, in parts: only what is used has to fit into the memory."""
_OTHERS = {
    b"\x1f\x8b": "compressed (gzip): unpack it first, gunzip",
    b"BZh": "compressed (bzip2): unpack it first, bunzip2",
    b"TDSm": "LabVIEW TDMS: export it as text (CSV)",
    b"ARROW1": "Arrow (Feather): save it as Parquet",
    b"\xd0\xcf\x11\xe0": "an Excel workbook: save it as CSV",
    b"\x80\x04": "a Python pickle, which is never loaded: save columns with numpy.savez",
    b"\x80\x05": "a Python pickle, which is never loaded: save columns with numpy.savez",
}


def read_table(file: Path) -> Table:
    """The columns of `file`. CheckFailed where it is not there, or no recording, with what would be right."""
    reader = _reader(file, _head(file))
    table = reader(file)
    table.kind = reader.__name__.removeprefix("read_")
    return table


def open_telemetry(file: Path) -> Telemetry:
    """A recording of ours. CheckFailed where it is not there, or something else."""
    if not is_recording(file):
        raise CheckFailed(f"{file}: no recording of ours, an MCAP file of `run --record` or `recording start`")
    return open_mcap(file)


def is_recording(file: Path) -> bool:
    """Whether `file` is MCAP, as recordings of ours are. CheckFailed where it can't be read."""
    return _head(file).startswith(MAGIC)


def _head(file: Path) -> bytes:
    try:
        with open_regular(file, _PARTS) as opened:
            return opened.read(1024)
    except OSError as problem:
        why = "no such file" if isinstance(problem, FileNotFoundError) else f"can't be read: {problem.strerror}"
        raise CheckFailed(f"{file}: {why}") from problem


def _reader(file: Path, head: bytes) -> Callable[[Path], Table]:
    if not head:
        raise CheckFailed(f"{file}: it is empty; a recording is {KINDS}")
    for magic, what in _OTHERS.items():
        if head.startswith(magic):
            raise CheckFailed(f"{file}: this is {what}; a recording is {KINDS}")
    if head.startswith(_HDF5):
        return read_hdf5
    if head.startswith(MAGIC):
        return read_mcap
    if head.startswith(b"MATLAB ") or _HDF5 == head[512:520] or (file.suffix.lower() == ".mat" and b"\0" in head):
        return read_matlab
    if head.startswith(b"\x93NUMPY"):
        return read_npy
    if head.startswith(b"PK\3\4"):
        return read_npz
    if head.startswith(b"PAR1"):
        return read_parquet
    if head.lstrip(b"\xef\xbb\xbf \r\n\t")[:1] == b"{" or re.match(rb"\s*\[\s*\{", head):
        return read_json
    return read_text
