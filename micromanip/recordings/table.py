"""Columns of a file by name, read when they are asked for."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, did_you_mean

from .units import known, split_unit

Array = NDArray[np.float64]

_TIMES = {"t", "time", "zeit", "x_value", "x-axis", "timestamp", "time stamp", "date/time", "seconds", "second", "sec"}
_TIME_WORD = re.compile(
    r"(?<![a-z])(t|times?|timestamps?|stamp|zeit|uhrzeit|datetime|elapsed|secs?|millis|micros)(?![a-z])"
)


class Table(Mapping[str, Array]):
    """Columns (n,) by their name in `file`; columns without a name are called "1", "2" and so on.

    `units` has those that the file states apart from the name, `lines` the line of the text at which each row stands;
    None where a file has no lines. `texts` are the columns that hold no numbers, each with a field that is none;
    `notes` say what of the file is in none of them.
    """

    def __init__(
        self,
        file: Path,
        columns: Mapping[str, Array | Callable[[], Array]],
        units: Mapping[str, str] | None = None,
        lines: Sequence[int] | None = None,
        texts: Mapping[str, str] | None = None,
        notes: Sequence[str] = (),
    ) -> None:
        self.file, self.lines, self.texts, self.notes = file, lines, dict(texts or {}), tuple(notes)
        self.kind = ""
        self._columns = dict(columns)
        self._units = dict(units or {})

    def __getitem__(self, name: str) -> Array:
        found = self._columns[name]
        if callable(found):
            found = self._columns[name] = found()
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def unit(self, name: str) -> str | None:
        """The unit of a column as the file or the column's name states it; None where neither does."""
        return self._units.get(name) or split_unit(name)[1]

    def where(self, row: int) -> str:
        """The place of `row` for a message: file and line, or file and number of the row, from 0."""
        return f"{self.file}: row {row}" if self.lines is None else f"{self.file}:{self.lines[row]}"

    def place(self, time_name: str | None) -> str:
        """What the file is, where its rows stand, and what their times are."""
        rows = f", rows in lines {self.lines[0]} to {self.lines[-1]}" if self.lines else ""
        return f"{self.kind}{rows}, {'no times' if time_name is None else f'time {time_name}'}"

    def resolve(self, asked: str) -> tuple[str, str | None]:
        """Name and unit of the column that ``NAME[:unit]`` means. CheckFailed where there is none.

        NAME is the whole name, or the name without its unit where only one column is called so.
        """
        name, _, unit = asked.rpartition(":")
        found = self._find(asked)
        if found is not None:
            return found, self.unit(found)
        found = self._find(name) if name else None
        if found is not None and known(unit) is not None:
            return found, unit
        if found is not None:
            raise CheckFailed(f"{self.file}: {asked}: {unit!r} is no unit known here; um, mm, nm, V, mV, s, ms are")
        if len(self) == 0:
            raise CheckFailed(f"{self.file}: there is no column of numbers in it")
        wanted = name if name and known(unit) is not None else asked
        for text, field in self.texts.items():
            if wanted in (text, split_unit(text)[0]):
                held = f"holds no numbers, but {field[:40]!r}" if field else "is empty"
                raise CheckFailed(f"{self.file}: {text} {held}")
        hint = did_you_mean(wanted, self, "its columns are")
        raise CheckFailed(f"{self.file}: there is no column {wanted}; {hint}")

    def listed(self, asked: str) -> list[str]:
        """The columns of a list with commas between them, which names may have too: quoted, or where one is called so.

        CheckFailed for an empty name.
        """
        parts = next(csv.reader([asked], skipinitialspace=True)) if '"' in asked else asked.split(",")
        found: list[str] = []
        while parts:
            joined = (",".join(parts[:count]).strip() for count in range(len(parts), 0, -1))
            name = next((each for each in joined if self._names(each)), parts[0].strip())
            found.append(name)
            parts = parts[name.count(",") + 1 :] if '"' not in asked else parts[1:]
        return found

    def _names(self, asked: str) -> bool:
        name, _, unit = asked.rpartition(":")
        return self._find(asked) is not None or (self._find(name) is not None and known(unit) is not None)

    def _find(self, asked: str) -> str | None:
        if asked in self._columns:
            return asked
        bare = [name for name in self if split_unit(name)[0] == asked or name.rpartition(".")[2] == asked]
        return bare[0] if len(bare) == 1 else None

    def time_column(self, names: Sequence[str] = ()) -> str | None:
        """The column of the time of `names`: by its unit, its name, a word of it, or the first that begins with t.

        Of several that are times by unit or name, the one that is in most groups with them; one by a letter must
        never fall, one by a word only if another doesn't.
        """
        others = [name for name in self if name not in names]
        timed = [name for name in others if (unit := known(self.unit(name) or "")) and unit.dimension == "time"]
        plain = [name for name in others if self.unit(name) is None]
        called = [name for name in plain if called_time(name) or called_time(name.rpartition(".")[2])]
        like_t = [name for name in [*timed, *plain] if name.lower().startswith("t")]
        sure = [*(name for name in timed if name in like_t or name.rpartition(".")[2].lower().startswith("t")), *called]
        # of run1.t and run2.t, that of the group in which the columns are
        near = sorted(sure, key=lambda name: -max((_shared(name, each) for each in names), default=0))
        worded = [name for name in plain if has_time_word(name)]
        perhaps = [name for name in [*worded, *like_t] if _rises(self[name])]
        return next(iter([*near, *timed, *perhaps, *worded]), None)


def table_line(fields: Iterable[str]) -> str:
    """Numbers between commas; what is not known is ``NaN``, since polars takes a column with a ``nan`` for text."""
    return ",".join(fields).replace("nan", "NaN")


def called_time(name: str) -> bool:
    """Whether a column is called as times are."""
    return name.lower() in _TIMES


def has_time_word(name: str) -> bool:
    """Whether a word of a name is one for time: ``__time``, ``sampling_time``, ``samplingTime``."""
    return _TIME_WORD.search(re.sub("(?<=[a-z])(?=[A-Z])", "_", name).lower()) is not None


def _rises(values: Array) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    return bool(np.all(steps >= 0.0) and np.any(steps > 0.0))


def _shared(name: str, other: str) -> int:
    """How many groups two columns are both in: 1 for run.t and run.u."""
    pairs = zip(name.split(".")[:-1], other.split(".")[:-1], strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
