"""A recording of ours in the formats of others: HDF5, Parquet, CSV, MATLAB. Every number keeps its bits."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, UsageError, did_you_mean, system_error
from micromanip.extras import required
from micromanip.files.table_line import table_line

from .hdf5 import ENDINGS as HDF5
from .telemetry import Telemetry
from .units import split_unit

_TIME = "t_s"
_MAT_BYTES = 2_000_000_000
"""MATLAB's format up to version 7.2 takes no larger variable."""

Cut = tuple[float, float]
"""From and to, in seconds from the first cycle of the recording."""


class Exported(NamedTuple):
    """What was written."""

    file: Path
    rows: int
    columns: list[str]
    bytes: int


def export(telemetry: Telemetry, to: Path, cut: Cut | None = None, signals: Sequence[str] = ()) -> Exported:
    """Write columns within `cut` to the new file `to`: all, or `signals` by their names, with or without the axis.

    HDF5 without `signals` has the layout of `run --record`: whole rows, state, parameters, configuration. Raises
    UsageError for a wrong name or place, DeviceUnavailable without the library, CheckFailed for a damaged file.
    """
    writer = _WRITERS.get(to.suffix.lower())
    if writer is None:
        raise UsageError(f"--to {to}: expected a file that ends in {', '.join(_WRITERS)}")
    names = _chosen(telemetry, signals)
    if writer is _write_hdf5 and not signals:
        writer = _write_rows
    try:
        with to.open("xb"):
            pass
    except FileExistsError:
        raise UsageError(f"--to {to} is there already: nothing is replaced; name another file") from None
    except OSError as problem:
        raise system_error(problem, f"--to {to}") from problem
    try:
        with required(f"--to {to}", "formats"):
            rows = writer(telemetry, to, names, cut or (0.0, np.inf))
        if cut is not None:
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


def _inside(telemetry: Telemetry, cycles: NDArray[Any], first: int, cut: Cut) -> NDArray[np.bool_]:
    t_s = (cycles - first) * (telemetry.period_ns * 1e-9)
    return np.asarray((t_s >= cut[0]) & (t_s <= cut[1]))


def _parts(telemetry: Telemetry, names: Mapping[str, str], cut: Cut) -> Iterator[dict[str, NDArray[Any]]]:
    """The columns, part by part, each in its own type; with the time."""
    first = None
    for part in telemetry.parts(["cycle", *names.values()]):
        cycles = part["cycle"]
        first = int(cycles[0]) if first is None and len(cycles) else first
        chosen = _inside(telemetry, cycles, first or 0, cut)
        if chosen.any():
            time = {_TIME: (cycles[chosen] - first) * (telemetry.period_ns * 1e-9)}
            yield time | {name: part[path][chosen] for name, path in names.items()}


def _write_rows(telemetry: Telemetry, to: Path, _names: Mapping[str, str], cut: Cut) -> int:
    """Whole rows, as the recorder writes them; the state only where they begin with it."""
    import h5py

    with h5py.File(to, "w", libver=("v110", "v110")) as file:
        for name in ("configuration", "sha256", "axes", "period_ns", "sources"):
            file.attrs[name] = getattr(telemetry, name)
        file.attrs["lost"] = telemetry.end.get("lost", 0)
        file.attrs["complete"] = telemetry.end.get("complete", False)
        file.attrs["problem"] = np.array(str(telemetry.end.get("problem", "")).encode(), "S200")
        rows = file.create_dataset("rows", (0,), telemetry.dtype, maxshape=(None,), chunks=(1000,))
        first = None
        for part in telemetry.rows():
            first = int(part["cycle"][0]) if first is None and len(part) else first
            kept = part[_inside(telemetry, part["cycle"], first or 0, cut)]
            rows.resize((len(rows) + len(kept),))
            rows[len(rows) - len(kept) :] = kept
        if telemetry.state is not None and cut[0] == 0.0:
            file.create_dataset("state", data=telemetry.state)
        if telemetry.states:
            file.create_dataset("states", data=np.concatenate(telemetry.states))
        if telemetry.samples is not None:
            file.create_dataset("samples", data=telemetry.samples)
        if telemetry.parameters:
            file.create_dataset("parameters", data=np.concatenate(telemetry.parameters))
        return len(rows)


def _write_hdf5(telemetry: Telemetry, to: Path, names: Mapping[str, str], cut: Cut) -> int:
    import h5py

    count = 0
    with h5py.File(to, "w") as file:
        for part in _parts(telemetry, names, cut):
            for name, values in part.items():
                if name not in file:
                    file.create_dataset(name, (0,), values.dtype, maxshape=(None,), chunks=(8192,))
                    file[name].attrs["units"] = split_unit(name)[1] or ""
                file[name].resize((count + len(values),))
                file[name][count:] = values
            count += len(part[_TIME])
    return count


def _write_parquet(telemetry: Telemetry, to: Path, names: Mapping[str, str], cut: Cut) -> int:
    import pyarrow
    from pyarrow import parquet

    writer, count = None, 0
    about = {"configuration": telemetry.configuration, "sha256": telemetry.sha256, "axes": ",".join(telemetry.axes)}
    try:
        for part in _parts(telemetry, names, cut):
            fields = [
                pyarrow.field(
                    name, pyarrow.from_numpy_dtype(values.dtype), metadata={"unit": split_unit(name)[1] or ""}
                )
                for name, values in part.items()
            ]
            table = pyarrow.Table.from_arrays([pyarrow.array(v) for v in part.values()], schema=pyarrow.schema(fields))
            if writer is None:
                writer = parquet.ParquetWriter(to, table.schema.with_metadata(about), compression="zstd")
            writer.write_table(table.replace_schema_metadata(about))
            count += len(table)
    finally:
        if writer is not None:
            writer.close()
    if writer is None:
        raise CheckFailed(f"{telemetry.file}: there are no rows in that part")
    return count


def _write_csv(telemetry: Telemetry, to: Path, names: Mapping[str, str], cut: Cut) -> int:
    """As many digits as bring each number back."""
    count = 0
    with to.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join([_TIME, *names]) + "\n")
        for part in _parts(telemetry, names, cut):
            rows = zip(*(values.tolist() for values in part.values()), strict=True)
            file.writelines(table_line(map(repr, row)) + "\n" for row in rows)
            count += len(part[_TIME])
    return count


def _write_matlab(telemetry: Telemetry, to: Path, names: Mapping[str, str], cut: Cut) -> int:
    from scipy.io import savemat

    gathered: dict[str, list[NDArray[Any]]] = {}
    size = 0
    for part in _parts(telemetry, names, cut):
        for name, values in part.items():
            gathered.setdefault(name, []).append(values)
            size += values.nbytes
        if size > _MAT_BYTES:
            raise CheckFailed(f"{to}: more than a .mat file takes; choose with --signals and --cut, or --to FILE.h5")
    columns = {name: np.concatenate(values) for name, values in gathered.items()}
    about = {"configuration": telemetry.configuration, "sha256": telemetry.sha256}
    savemat(to, {**columns, **about}, appendmat=False, long_field_names=True, oned_as="column", do_compression=True)
    return len(columns.get(_TIME, ()))


_Writer = Callable[[Telemetry, Path, Mapping[str, str], Cut], int]
_WRITERS: dict[str, _Writer] = {
    **dict.fromkeys(HDF5, _write_hdf5),
    ".parquet": _write_parquet,
    ".csv": _write_csv,
    ".mat": _write_matlab,
}
