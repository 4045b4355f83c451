"""Experiments for a linear fit: columns of recordings, judged before anything is fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import decimate

from micromanip.design.table import column, read_table, require_movement, require_numbers, sampling, time_column
from micromanip.errors import CheckFailed

from .modal import Array

_LEAST_SAMPLES = 200
_SAME_RATE, _WHOLE = 0.01, 0.01
_COPY = 1e-9


@dataclass(frozen=True)
class LinearRecord:
    """Inputs (n, m) and outputs (n, l) sampled every `dt` seconds, and where they came from."""

    file: Path
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    u: Array
    y: Array
    dt: float

    def split(self, share: float) -> tuple[LinearRecord, LinearRecord | None]:
        """The first `share` of the record, and the rest, if any. CheckFailed where one of them is too short."""
        count = round(share * len(self.u))
        parts = [slice(None, count)] if count == len(self.u) else [slice(None, count), slice(count, None)]
        records = [
            LinearRecord(self.file, self.inputs, self.outputs, self.u[part], self.y[part], self.dt) for part in parts
        ]
        for record in records:
            if len(record.u) < _LEAST_SAMPLES // 2:
                raise CheckFailed(
                    f"{self.file}: split at {share:g}, a part of {len(record.u)} samples is left, which is too short; "
                    f"at least {_LEAST_SAMPLES // 2} are needed"
                )
            still = [
                name
                for names, values in ((self.inputs, record.u), (self.outputs, record.y))
                for name, moved in zip(names, np.ptp(values, axis=0), strict=True)
                if moved <= 1e-12 * max(1.0, float(np.abs(values).max()))
            ]
            if still:
                part = "first" if record is records[0] else "last"
                raise CheckFailed(
                    f"{self.file}: split at {share:g}, {still[0]} stands still in the {part} {len(record.u)} samples: "
                    "split elsewhere, or give --split 1 and another record that moves with --validate"
                )
        return records[0], records[1] if len(records) > 1 else None


def load_linear(
    file: Path, inputs: Sequence[str], outputs: Sequence[str], dt: float | None, time_name: str | None = None
) -> LinearRecord:
    """Read the columns `inputs` and `outputs` of a CSV, a text without header (by number), or a recording of ours.

    `dt` is the sampling interval, s, of the model: that of the record's time column (by default the first whose name
    begins with t), or a whole multiple of it, for which the record is low-passed and thinned. Raises CheckFailed, with
    what to record instead, for data that can't be used.
    """
    table = read_table(file)
    u, y = ({name: column(file, table, name) for name in names} for names in (inputs, outputs))
    require_numbers(file, u | y, table.first_line)
    if len(next(iter(u.values()))) < _LEAST_SAMPLES:
        raise CheckFailed(f"{file}: {len(table[inputs[0]])} samples are too few; record at least {_LEAST_SAMPLES}")
    require_movement(file, u | y)
    _require_different(file, u)
    time = time_name or time_column(table)
    if time is None:
        if dt is None:
            raise CheckFailed(
                f"{file}: there is no time column (a name that begins with t); name it with --time, or give --dt"
            )
        thin = 1
    else:
        step = sampling(file, time, column(file, table, time))
        dt = step if dt is None else dt
        thin = _thinning(file, time, step, dt)
    stacked = [np.column_stack(list(columns.values())) for columns in (u, y)]
    if thin > 1:
        # both go through the same filter, which so cancels in the model
        stacked = [np.asarray(decimate(values, thin, ftype="fir", axis=0)) for values in stacked]
    return LinearRecord(file, tuple(inputs), tuple(outputs), stacked[0], stacked[1], dt)


def _thinning(file: Path, time: str, step: float, dt: float) -> int:
    ratio = dt / step
    if abs(ratio - round(ratio)) > _WHOLE * ratio or round(ratio) < 1:
        raise CheckFailed(
            f"{file}: --dt {dt:.6g} s is no whole multiple of the record's sampling interval, {step:.6g} s by {time}"
        )
    return round(ratio)


def _require_different(file: Path, columns: dict[str, Array]) -> None:
    """Inputs that are copies of one another can't be told apart."""
    names = list(columns)
    table = np.column_stack(list(columns.values()))
    table = (table - table.mean(axis=0)) / table.std(axis=0)
    values, vectors = np.linalg.eigh(table.T @ table / len(table))
    if values[0] < _COPY:
        involved = [name for name, share in zip(names, np.abs(vectors[:, 0]), strict=True) if share > 0.1]
        raise CheckFailed(
            f"{file}: the inputs {', '.join(involved)} move together, so their effects can't be told apart; "
            "excite each on its own"
        )


def same_rate(records: Sequence[LinearRecord]) -> None:
    """CheckFailed unless all records are sampled alike."""
    first = records[0]
    for other in records[1:]:
        if abs(other.dt / first.dt - 1.0) > _SAME_RATE:
            raise CheckFailed(
                f"{other.file}: sampled every {other.dt:.6g} s, {first.file} every {first.dt:.6g} s; "
                "record all at one rate"
            )
