"""A recording for identification: read from CSV or from our own HDF5, and judged before anything is fitted to it."""

from __future__ import annotations

import difflib
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

Array = NDArray[np.float64]

_LEAST_SAMPLES = 200
_UNEVEN = 0.01
_CLIPPED_RUN, _CLIPPED_SHARE = 8, 0.005


@dataclass(frozen=True)
class Record:
    """Input (n,) and output (n,) sampled every `step_s`, and where they came from."""

    file: Path
    input_name: str
    output_name: str
    u: Array
    y: Array
    step_s: float

    def burn_in(self, seconds: float) -> int:
        """Samples that do not count; CheckFailed where too few would be left."""
        samples = round(seconds / self.step_s)
        if len(self.u) - samples < _LEAST_SAMPLES:
            raise CheckFailed(
                f"{self.file}: {len(self.u)} samples less {samples} of burn-in are too few to fit to: record at least "
                f"{_LEAST_SAMPLES} more, several periods of the slowest movement"
            )
        return samples


def load_record(
    file: Path, input_name: str, output_name: str, time_name: str | None = None, step_s: float | None = None
) -> Record:
    """Read two columns of a CSV with a header, or of a recording made by ``run --record`` or ``identify``.

    The sampling interval is that of the column `time_name` (by default the first whose name begins with
    ``t``), or `step_s`. Raises CheckFailed, with what to record instead, for data that can't be used.
    """
    if not file.is_file():
        raise CheckFailed(f"{file}: no such file")
    table = _read_hdf5(file) if file.suffix in (".h5", ".hdf5") else _read_csv(file)
    u, y = (_column(file, table, name) for name in (input_name, output_name))
    if step_s is None:
        name = time_name or next((column for column in table if column.lower().startswith("t")), None)
        if name is None:
            raise CheckFailed(
                f"{file}: there is no time column (a name that begins with t); name it with --time, or give --dt"
            )
        step_s = _sampling(file, name, _column(file, table, name))
    record = Record(file, input_name, output_name, u, y, step_s)
    _judge(record)
    return record


def _read_csv(file: Path) -> dict[str, Array]:
    try:
        with file.open(encoding="utf-8-sig") as lines, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # numpy's, about a file without rows
            names = [name.strip().strip('"') for name in lines.readline().strip().split(",")]
            values = np.genfromtxt(lines, delimiter=",", ndmin=2)
    except UnicodeDecodeError as problem:
        raise CheckFailed(f"{file}: not a table of numbers with a header, separated by commas") from problem
    except ValueError as problem:
        row = re.search(r"Line #(\d+)", str(problem))
        line = f":{int(row[1]) + 1}" if row else ""
        raise CheckFailed(f"{file}{line}: this row has not as many values as there are columns") from problem
    except OSError as problem:
        raise CheckFailed(f"{file}: can't be read: {problem.strerror}") from problem
    if values.size == 0 or values.shape[1] != len(names):
        raise CheckFailed(f"{file}: not a table of numbers with a header of as many names, separated by commas")
    return {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)}


def _read_hdf5(file: Path) -> dict[str, Array]:
    try:
        import h5py
    except ImportError as problem:
        raise CheckFailed("reading HDF5 needs the extra: pip install micromanip[recording]") from problem
    try:
        with h5py.File(file) as recording:
            rows, axes = recording["rows"][:], list(recording.attrs["axes"])
            step_s = float(recording.attrs["period_ns"]) * 1e-9
    except (OSError, KeyError) as problem:
        raise CheckFailed(f"{file}: not a recording of micromanip: {problem}") from problem
    table = {"t_s": (rows["cycle"] - rows["cycle"][0]) * step_s}
    for i, axis in enumerate(axes):
        for name in rows["axis"].dtype.names or ():
            table[f"{name}_{axis}"] = np.ascontiguousarray(rows["axis"][name][:, i], dtype=float)
    return table


def _column(file: Path, table: dict[str, Array], name: str) -> Array:
    if name in table:
        return table[name]
    near = difflib.get_close_matches(name, table, 1)
    hint = f"did you mean {near[0]}?" if near else f"its columns are {', '.join(table)}"
    raise CheckFailed(f"{file}: there is no column {name}; {hint}")


def _sampling(file: Path, name: str, t: Array) -> float:
    steps = np.diff(t)
    bad = np.flatnonzero(~np.isfinite(t))
    if len(bad):
        raise CheckFailed(f"{file}:{int(bad[0]) + 2}: the time column {name} has no number here")
    if len(steps) == 0:
        raise CheckFailed(f"{file}: 1 sample is too few; record at least {_LEAST_SAMPLES}")
    step = float(np.median(steps))
    uneven = np.flatnonzero(np.abs(steps - step) > _UNEVEN * abs(step))
    if step <= 0 or len(uneven):
        line = int(uneven[0]) + 3 if len(uneven) else 3
        raise CheckFailed(
            f"{file}:{line}: {name} does not rise evenly (steps of {step:.6g} s, here {steps[line - 3]:.6g} s); "
            "record at a fixed rate, or resample first"
        )
    return float(t[-1] - t[0]) / len(steps)


def _judge(record: Record) -> None:
    """Raise for a record that no hysteresis model can be fitted to."""
    file = record.file
    for name, values in ((record.input_name, record.u), (record.output_name, record.y)):
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise CheckFailed(
                f"{file}:{int(bad[0]) + 2}: {name} has no number here ({len(bad)} in all); "
                "cut the record, or repair the sensor"
            )
    if len(record.u) < _LEAST_SAMPLES:
        raise CheckFailed(f"{file}: {len(record.u)} samples are too few; record at least {_LEAST_SAMPLES}")
    for name, values in ((record.input_name, record.u), (record.output_name, record.y)):
        if np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())):
            raise CheckFailed(
                f"{file}: {name} is constant: record while the actuator moves over the stroke that it will use"
            )
    _judge_clipping(record)
    _judge_movement(record)


def _judge_clipping(record: Record) -> None:
    moving = np.abs(np.gradient(record.u)) > 1e-6 * np.ptp(record.u)
    for end, limit in (("top", record.y.max()), ("bottom", record.y.min())):
        stuck = (record.y == limit) & moving
        if stuck.sum() >= max(_CLIPPED_RUN, _CLIPPED_SHARE * len(stuck)) and _longest_run(stuck) >= _CLIPPED_RUN:
            raise CheckFailed(
                f"{record.file}: {record.output_name} sticks at its {end} value {limit:.6g} for "
                f"{_longest_run(stuck)} samples while the input moves: the sensor is clipped; "
                "shift its range, or record a smaller movement"
            )


def _longest_run(flags: NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.view(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max()) if len(edges) else 0


def _judge_movement(record: Record) -> None:
    """The output must follow the input, rising with it, and lag behind it."""
    u, y = record.u, record.y
    correlation = float(np.corrcoef(u, y)[0, 1])
    if correlation < -0.5:
        raise CheckFailed(
            f"{record.file}: {record.output_name} falls when {record.input_name} rises: turn the sensor's sign, "
            "or name the right columns"
        )
    if correlation < 0.5:
        raise CheckFailed(
            f"{record.file}: {record.output_name} hardly follows {record.input_name} (correlation {correlation:.2f}): "
            "are these the columns of one axis, recorded together?"
        )
    middle = 0.5 * (u.max() + u.min())
    crossings = np.count_nonzero(np.diff(np.sign(u - middle)) != 0)
    if crossings < 4:
        raise CheckFailed(
            f"{record.file}: {record.input_name} passes its middle only {crossings} times: "
            "record at least two full periods"
        )
    # a lagging output encloses area clockwise in the (y, u) plane; swapped columns turn it around
    area = float(np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(u)) - 0.5 * (y[-1] + y[0]) * (u[-1] - u[0]))
    if area > 1e-3 * crossings / 2 * np.ptp(u) * np.ptp(y):
        raise CheckFailed(
            f"{record.file}: {record.output_name} runs ahead of {record.input_name}: the columns are probably mixed up "
            f"(--input is the voltage, --output the displacement)"
        )
