"""Columns of a recording: from CSV with a header, from plain text without one, or from our own HDF5.

What is wrong with a file is said in one sentence, CheckFailed, with the line where it is.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, did_you_mean
from micromanip.files.regular_file import require_regular

Array = NDArray[np.float64]

_UNEVEN = 0.01


class Table(dict[str, Array]):
    """Columns (n,) by name; columns of a text without a header are called "1", "2" and so on.

    `first_line` is where the rows begin in the file.
    """

    first_line = 2


def read_table(file: Path) -> Table:
    """All columns of `file`."""
    try:
        require_regular(file)
    except OSError as problem:
        why = "no such file" if isinstance(problem, FileNotFoundError) else f"can't be read: {problem.strerror}"
        raise CheckFailed(f"{file}: {why}") from problem
    return _read_hdf5(file) if file.suffix in (".h5", ".hdf5") else _read_text(file)


def _read_text(file: Path) -> Table:
    headerless = False
    try:
        with file.open(encoding="utf-8-sig") as lines, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # numpy's, about a file without rows
            first = lines.readline().strip()
            names = [name.strip().strip('"') for name in first.split(",")]
            separator: str | None = ","
            fields = first.split("," if "," in first else None)
            headerless = bool(fields) and all(map(_is_number, fields))
            if headerless:
                names = [str(number + 1) for number in range(len(fields))]
                separator = "," if "," in first else None
                lines.seek(0)
            values = np.genfromtxt(lines, delimiter=separator, ndmin=2)
    except UnicodeDecodeError as problem:
        raise CheckFailed(f"{file}: not a table of numbers with a header, separated by commas") from problem
    except ValueError as problem:
        row = re.search(r"Line #(\d+)", str(problem))
        line = f":{int(row[1]) + (not headerless)}" if row else ""
        raise CheckFailed(f"{file}{line}: this row has not as many values as there are columns") from problem
    except OSError as problem:
        raise CheckFailed(f"{file}: can't be read: {problem.strerror}") from problem
    if values.size == 0 or values.shape[1] != len(names):
        raise CheckFailed(f"{file}: not a table of numbers with a header of as many names, separated by commas")
    table = Table({name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)})
    table.first_line = 1 if headerless else 2
    return table


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_hdf5(file: Path) -> Table:
    try:
        import h5py
    except ImportError as problem:
        raise CheckFailed("reading HDF5 needs the extra: pip install micromanip[recording]") from problem
    try:
        with _opened(h5py, file) as recording:
            rows, axes = recording["rows"][:], list(recording.attrs["axes"])
            step_s = float(recording.attrs["period_ns"]) * 1e-9
    except (OSError, KeyError) as problem:
        raise CheckFailed(f"{file}: not a recording of micromanip: {problem}") from problem
    table = Table({"t_s": (rows["cycle"] - rows["cycle"][0]) * step_s})
    for i, axis in enumerate(axes):
        for name in rows["axis"].dtype.names or ():
            table[f"{name}_{axis}"] = np.ascontiguousarray(rows["axis"][name][:, i], dtype=float)
    return table


def _opened(h5py: Any, file: Path) -> Any:
    """The recording, also one whose recorder and host were killed: it is marked as open, and complete to a flush."""
    try:
        return h5py.File(file)
    except OSError:
        return h5py.File(file, swmr=True)


def column(file: Path, table: Mapping[str, Array], name: str) -> Array:
    """The column `name` (n,)."""
    if name in table:
        return table[name]
    raise CheckFailed(f"{file}: there is no column {name}; {did_you_mean(name, table, 'its columns are')}")


def time_column(table: Mapping[str, Array]) -> str | None:
    """The first column whose name begins with t."""
    return next((name for name in table if name.lower().startswith("t")), None)


def sampling(file: Path, name: str, t: Array) -> float:
    """Sampling interval of the time column `t` (n,), s."""
    steps = np.diff(t)
    bad = np.flatnonzero(~np.isfinite(t))
    if len(bad):
        raise CheckFailed(f"{file}:{int(bad[0]) + 2}: the time column {name} has no number here")
    if len(steps) == 0:
        raise CheckFailed(f"{file}: 1 sample is too few; record at least 200")
    step = float(np.median(steps))
    uneven = np.flatnonzero(np.abs(steps - step) > _UNEVEN * abs(step))
    if step <= 0 or len(uneven):
        line = int(uneven[0]) + 3 if len(uneven) else 3
        raise CheckFailed(
            f"{file}:{line}: {name} does not rise evenly (steps of {step:.6g} s, here {steps[line - 3]:.6g} s); "
            "record at a fixed rate, or resample first"
        )
    return float(t[-1] - t[0]) / len(steps)


def require_numbers(file: Path, columns: Mapping[str, Array], first_line: int = 2) -> None:
    """Refuse columns with gaps."""
    for name, values in columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise CheckFailed(
                f"{file}:{int(bad[0]) + first_line}: {name} has no number here ({len(bad)} in all); "
                "cut the record, or repair the sensor"
            )


def require_movement(file: Path, columns: Mapping[str, Array]) -> None:
    """Refuse columns that stand still."""
    for name, values in columns.items():
        if np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())):
            raise CheckFailed(
                f"{file}: {name} is constant: record while the actuator moves over the stroke that it will use"
            )
