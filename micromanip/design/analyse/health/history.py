"""The checks of an axis through the months: a CSV file with one row per check, which other programs read too.

A row has been written whole if it ends with its newline; what follows the last one is none, and the next check takes
its place. A tuning is named by its hash, as in reports: what was tuned anew is watched anew.
"""

from __future__ import annotations

import csv
import fcntl
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from micromanip.errors import CheckFailed
from micromanip.files import open_regular

from .figures import FIGURES

MARGINS = ("stage_gain_dB", "stage_phase_deg")
COLUMNS = (*FIGURES, *MARGINS)
LABELS = {
    "stage_gain": "stage gain, um/um",
    "mode_Hz": "mode, Hz",
    "mode_damping": "damping ratio",
    "actuator_um_per_V": "actuator, um/V",
    "stage_gain_dB": "gain margin, dB",
    "stage_phase_deg": "phase margin, deg",
}
"""For people."""
HEADER = ("time", "axis", "tuning", *COLUMNS)


@dataclass(frozen=True)
class Check:
    """One check: when (UTC), of which axis under which tuning, and its figures by the names of `COLUMNS`, or NaN.

    `deviations` are those of the `MARGINS`, of a check that was just made; the file does not keep them.
    """

    time: datetime
    axis: str
    tuning: str
    figures: dict[str, float]
    deviations: Mapping[str, float] = field(default_factory=dict)

    def row(self) -> list[str]:
        """As in the file; an empty field where there is no such figure."""
        values = ("" if math.isnan(value) else f"{value:.7g}" for value in (self.figures[name] for name in COLUMNS))
        return [self.time.isoformat(timespec="seconds"), self.axis, self.tuning, *values]


def read_history(file: Path) -> list[Check]:
    """All checks in the order of the file, none where there is no file yet; CheckFailed says what is wrong where."""
    try:
        with open_regular(file) as opened:
            text = opened.read().decode("utf-8-sig")
    except FileNotFoundError:
        return []
    except UnicodeDecodeError:
        raise CheckFailed(f"{file}: no text in UTF-8: is it a history of `micromanip analyse health`?") from None
    lines = text[: text.rfind("\n") + 1].splitlines()
    if not lines:
        return []
    rows = list(csv.reader(lines))
    if tuple(rows[0]) != HEADER:
        raise CheckFailed(f"{file}:1: no history of `micromanip analyse health`: its first line is {','.join(HEADER)}")
    return [_check(file, number, row) for number, row in enumerate(rows[1:], 2)]


def append(file: Path, check: Check) -> None:
    """Add a row, whole or not at all, after what `read_history` finds; CheckFailed, OSError where it can't be."""
    descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        read_history(file)  # nothing is added to what is not one
        kept = os.pread(descriptor, os.fstat(descriptor).st_size, 0).rfind(b"\n") + 1
        text = "" if kept else ",".join(HEADER) + "\n"
        os.ftruncate(descriptor, kept)
        os.pwrite(descriptor, (text + ",".join(check.row()) + "\n").encode(), kept)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _check(file: Path, number: int, row: list[str]) -> Check:
    where = f"{file}:{number}"
    if len(row) != len(HEADER):
        raise CheckFailed(f"{where}: {len(row)} fields, {len(HEADER)} are expected: {','.join(HEADER)}")
    try:
        time = datetime.fromisoformat(row[0])
    except ValueError:
        raise CheckFailed(f"{where}: time: {row[0]!r:.40} is no time like 2026-11-23T06:00:00+00:00") from None
    figures = {}
    for name, text in zip(COLUMNS, row[3:], strict=True):
        try:
            figures[name] = float(text) if text else math.nan
        except ValueError:
            raise CheckFailed(f"{where}: {name}: {text!r:.40} is not a number with a decimal point") from None
    return Check(time if time.tzinfo else time.replace(tzinfo=UTC), row[1], row[2], figures)
