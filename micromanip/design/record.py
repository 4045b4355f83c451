"""A recording for identification: read from CSV or from our own HDF5, and judged before anything is fitted to it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

from .table import column, read_table, require_movement, require_numbers, sampling, time_column

Array = NDArray[np.float64]

_LEAST_SAMPLES = 200
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
    table = read_table(file)
    u, y = (column(file, table, name) for name in (input_name, output_name))
    if step_s is None:
        name = time_name or time_column(table)
        if name is None:
            raise CheckFailed(
                f"{file}: there is no time column (a name that begins with t); name it with --time, or give --dt"
            )
        step_s = sampling(file, name, column(file, table, name))
    record = Record(file, input_name, output_name, u, y, step_s)
    judge_record(record)
    return record


def judge_record(record: Record) -> None:
    """Raise for a record that no hysteresis model can be fitted to."""
    file = record.file
    require_numbers(file, {record.input_name: record.u, record.output_name: record.y})
    if len(record.u) < _LEAST_SAMPLES:
        raise CheckFailed(f"{file}: {len(record.u)} samples are too few; record at least {_LEAST_SAMPLES}")
    require_movement(file, {record.input_name: record.u, record.output_name: record.y})
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
