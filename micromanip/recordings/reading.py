"""A file by what it holds, not by what it is called: one reader for each kind, one message for what can't be read."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from micromanip.errors import CheckFailed
from micromanip.files import open_regular

from .binary import read_hdf5, read_matlab, read_npy, read_npz, read_parquet
from .mcap_reading import MAGIC, open_mcap, read_mcap
from .table import Table
from .telemetry import Telemetry
from .text import read_text

KINDS = "CSV or other text, .mat, .npy, .npz, MCAP, HDF5 or Parquet"
_HDF5 = b"\x89HDF\r\n\x1a\n"
_PARTS = 1_000_000_000_000
"""Bytes of a file whose columns are read on their own, in parts: only what is used has to fit into the memory."""
_OTHERS = {
    rb"\s*(\xef\xbb\xbf)?\s*(\[\s*)?\{": "JSON: save its columns as CSV",
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
        if re.match(magic, head):
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
    return read_text
