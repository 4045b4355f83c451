"""A recording of ours in the formats of others: HDF5, Parquet, CSV, MATLAB, NumPy. Every number keeps its bits."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, UsageError, did_you_mean, system_error
from micromanip.extras import required

from .table import table_line
from .telemetry import Telemetry
from .units import split_unit

_TIME = "t_s"
_MOST_BYTES = 2_000_000_000
"""Gathered in memory; MATLAB's format up to version 7.2 takes no larger variable."""

Cut = tuple[float, float]
"""From and to, in seconds from the first cycle of the recording."""
Parts = Iterator[dict[str, NDArray[Any]]]
"""The columns, part by part, each in its own type; the time first."""
About = Mapping[str, str]


class Exported(NamedTuple):
    """What was written."""

    file: Path
    rows: int
    columns: list[str]
    bytes: int


def export(telemetry: Telemetry, to: Path, cut: Cut | None = None, signals: Sequence[str] = ()) -> Exported:
    """Write columns within `cut` to the new file `to`: all, or `signals` by their names, with or without the axis.

    Raises UsageError for a wrong name or place, or an empty part, and CheckFailed for a damaged file.
    """
    writer = _WRITERS.get(to.suffix.lower())
    if writer is None:
        raise UsageError(f"--to {to}: expected a file that ends in {', '.join(_WRITERS)}")
    names = _chosen(telemetry, signals)
    about = {"configuration": telemetry.configuration, "sha256": telemetry.sha256, "axes": ",".join(telemetry.axes)}
    rows = 0

    def counted() -> Parts:
        nonlocal rows
        for part in _parts(telemetry, names, cut or (0.0, np.inf)):
            rows += len(part[_TIME])
            yield part

    try:
        with to.open("xb"):
            pass
    except FileExistsError:
        raise UsageError(f"--to {to} is there already: nothing is replaced; name another file") from None
    except OSError as problem:
        raise system_error(problem, f"--to {to}") from problem
    try:
        with required(f"--to {to}", "formats"):
            writer(to, counted(), about)
        _require_any(rows, telemetry)
    except BaseException as problem:
        with contextlib.suppress(OSError):
            to.unlink()
        if isinstance(problem, OSError):
            raise system_error(problem, to) from problem
        raise
    return Exported(to, rows, [_TIME, *names], to.stat().st_size)


def _require_any(rows: int, telemetry: Telemetry) -> None:
    if rows == 0:
        ends = [part["cycle"][[0, -1]] for part in telemetry.parts(["cycle"]) if len(part["cycle"])]
        length_s = float(ends[-1][1] - ends[0][0]) * telemetry.period_ns * 1e-9 if ends else 0.0
        raise UsageError(f"{telemetry.file}: no cycle is within --cut; it has {length_s:.6g} s")


def _chosen(telemetry: Telemetry, signals: Sequence[str]) -> dict[str, str]:
    """Paths of the columns that are meant, by name."""
    known = telemetry.names()
    found: dict[str, str] = {}
    for signal in signals:
        each = [f"{signal}_{axis}" for axis in telemetry.axes if f"{signal}_{axis}" in known]
        if signal not in known and not each:
            raise UsageError(f"{telemetry.file}: there is no column {signal}; {did_you_mean(signal, known)}")
        found |= {name: known[name] for name in ([signal] if signal in known else each)}
    return found or known


def _parts(telemetry: Telemetry, names: Mapping[str, str], cut: Cut) -> Parts:
    first = None
    for part in telemetry.parts(["cycle", *names.values()]):
        cycles = part["cycle"]
        first = int(cycles[0]) if first is None and len(cycles) else first
        t_s = (cycles - (first or 0)) * (telemetry.period_ns * 1e-9)
        chosen = (t_s >= cut[0]) & (t_s <= cut[1])
        if chosen.any():
            yield {_TIME: t_s[chosen]} | {name: part[path][chosen] for name, path in names.items()}


def _write_hdf5(to: Path, parts: Parts, about: About) -> None:
    import h5py

    with h5py.File(to, "w") as file:
        file.attrs.update(about)
        for part in parts:
            for name, values in part.items():
                if name not in file:
                    file.create_dataset(name, (0,), values.dtype, maxshape=(None,), chunks=(8192,))
                    file[name].attrs["units"] = split_unit(name)[1] or ""
                written = len(file[name])
                file[name].resize((written + len(values),))
                file[name][written:] = values


def _write_parquet(to: Path, parts: Parts, about: About) -> None:
    import pyarrow
    from pyarrow import parquet

    with contextlib.ExitStack() as opened:
        writer = None
        for part in parts:
            fields = [
                pyarrow.field(name, pyarrow.from_numpy_dtype(each.dtype), metadata={"unit": split_unit(name)[1] or ""})
                for name, each in part.items()
            ]
            table = pyarrow.Table.from_arrays(list(map(pyarrow.array, part.values())), schema=pyarrow.schema(fields))
            table = table.replace_schema_metadata(about)
            writer = writer or opened.enter_context(parquet.ParquetWriter(to, table.schema, compression="zstd"))
            writer.write_table(table)


def _write_csv(to: Path, parts: Parts, _: About) -> None:
    """As many digits as bring each number back."""
    with to.open("w", encoding="utf-8", newline="\n") as file:
        for number, part in enumerate(parts):
            if number == 0:
                file.write(",".join(part) + "\n")
            rows = zip(*(values.tolist() for values in part.values()), strict=True)
            file.writelines(table_line(map(repr, row)) + "\n" for row in rows)


def _write_matlab(to: Path, parts: Parts, about: About) -> None:
    from scipy.io import savemat

    columns = {**_gathered(to, parts), **about}
    savemat(to, columns, appendmat=False, long_field_names=True, oned_as="column", do_compression=True)


def _write_numpy(to: Path, parts: Parts, about: About) -> None:
    columns: dict[str, Any] = {**_gathered(to, parts), **about}
    with to.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **columns)


def _gathered(to: Path, parts: Parts) -> dict[str, NDArray[Any]]:
    gathered: dict[str, list[NDArray[Any]]] = {}
    size = 0
    for part in parts:
        for name, values in part.items():
            gathered.setdefault(name, []).append(values)
            size += values.nbytes
        if size > _MOST_BYTES:
            raise CheckFailed(f"{to}: more than such a file takes; choose with --signals and --cut, or --to FILE.h5")
    return {name: np.concatenate(values) for name, values in gathered.items()}


_WRITERS: dict[str, Callable[[Path, Parts, About], None]] = {
    ".h5": _write_hdf5,
    ".hdf5": _write_hdf5,
    ".parquet": _write_parquet,
    ".csv": _write_csv,
    ".mat": _write_matlab,
    ".npz": _write_numpy,
}
