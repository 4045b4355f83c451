"""Columns of a text: CSV of any dialect, and what oscilloscopes and LabVIEW write, with lines before the numbers.

The rows are found first: the dialect (separator, decimal mark) in which most lines near the middle are numbers, then
the first line from which on they are. Names stand in the line before, or a units row does, and the names before that.
"""

from __future__ import annotations

import contextlib
import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.files.regular_file import open_regular

from .encoding import decoded
from .stamps import is_stamp, stamps_s
from .table import Array, Table
from .thousands import marked_thousand
from .units import known

_DIALECTS = (("\t", "."), ("\t", ","), (";", "."), (";", ","), (",", "."), (",", ","), (None, "."), (None, ","))
"""Separator (None: spaces) and decimal mark; the first of those that fit is taken. Commas within a field are quoted."""
_SPACES = "'\N{RIGHT SINGLE QUOTATION MARK} \N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}\N{THIN SPACE}"
_THOUSANDS = {".": "," + _SPACES, ",": "." + _SPACES}
"""Marks between thousands, by the decimal mark."""
_GROUPED = {
    ".": re.compile(rf"[+-]?[1-9]\d{{0,2}}(([{_THOUSANDS['.']}]\d{{3}})+\.\d*|([{_SPACES}]\d{{3}})+|(,\d{{3}}){{2,}})"),
    ",": re.compile(rf"[+-]?[1-9]\d{{0,2}}([{_THOUSANDS[',']}]\d{{3}})+(,\d*)?"),
}
"""Numbers with such marks; 1,234 alone is none, since it may be a fraction of another country."""
_MINUS = str.maketrans("\N{MINUS SIGN}", "-")
_SAMPLED = 60
_PREAMBLE_ROWS = 10
"""Rows of numbers that may stand among the lines before a table; more of them are a table of their own."""
_COMMENT = "#%/*"
_NOTHING = ',;"\t '
"""What a line without values consists of, as spreadsheets leave them behind the last row."""
_EMPTY = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "inf", "-inf", "+inf", "infinity"}
_NO_TABLE = "not a table of numbers: one row per sample, separated by commas, semicolons, tabs or spaces, is read"


@dataclass(frozen=True)
class _Dialect:
    separator: str | None
    decimal: str

    def fields(self, line: str) -> list[str]:
        if self.separator is None:
            return line.split()
        found = line.split(self.separator)
        if '"' in line:
            with contextlib.suppress(csv.Error):
                found = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True))
        return [field.strip().strip('"').strip() for field in found]

    def number(self, field: str) -> float | None:
        """The number that a field is, NaN for an empty one, None for a text."""
        try:
            return self._float(field)
        except ValueError:
            pass
        plain = field.translate(_MINUS)
        if _GROUPED[self.decimal].fullmatch(plain):
            plain = plain.translate(str.maketrans("", "", _THOUSANDS[self.decimal]))
        try:
            return self._float(plain)
        except ValueError:
            return np.nan if field.lower() in _EMPTY else None

    def _float(self, field: str) -> float:
        if self.decimal == ".":
            return float(field)
        if "." in field:
            raise ValueError(field)
        return float(self.plain(field))

    def plain(self, field: str) -> str:
        """A field with a decimal point."""
        return field.replace(",", ".") if self.decimal == "," else field


def read_text(file: Path) -> Table:
    """A text. CheckFailed, with the line, where it is no table, or a row of it has not as many values as the others."""
    with open_regular(file) as opened:
        every = decoded(file, opened.read()).splitlines()
    while every and not every[-1].strip(_NOTHING):
        every.pop()
    numbers = [number for number, line in enumerate(every, 1) if line.strip()]
    lines = every if len(numbers) == len(every) else [every[number - 1] for number in numbers]
    dialect = _dialect(file, lines)
    first, kinds = _rows(file, lines, numbers, dialect)
    names, units = _header(file, every[: numbers[first] - 1], dialect, kinds)
    values = _values(file, lines[first:], numbers[first:], dialect, kinds)
    named = _unlike([name or _by_number(k, names) for k, name in enumerate(names, 1)])
    kept = [k for k, kind in enumerate(kinds) if kind and (names[k] or np.isfinite(values[k]).any())]
    for k in kept:
        fields = partial(_column, lines[first:], dialect, k)
        if kinds[k] == "number" and (at := marked_thousand(values[k], fields, dialect.decimal)) is not None:
            raise CheckFailed(
                f"{file}:{numbers[first + at]}: {named[k]} is {fields()[at]!r}, a thousand or more by the whole "
                "numbers beside it, or a fraction? Save it without marks between thousands"
            )
    stated = {named[k]: unit for k in kept if (unit := units[k])}
    stated |= {named[k]: "s" for k in kept if kinds[k] == "stamp"}
    begin = dialect.fields(lines[first])
    texts = {named[k]: begin[k] for k, kind in enumerate(kinds) if not kind and begin[k]}
    return Table(file, {named[k]: values[k] for k in kept}, stated, numbers[first:], texts=texts)


def _dialect(file: Path, lines: Sequence[str]) -> _Dialect:
    """The dialect in which most of some lines from the last half of the text are rows."""
    last_half = [line for line in lines[len(lines) // 2 :] if line.strip()]
    sampled = last_half[:: max(1, len(last_half) // _SAMPLED)]
    best, most = None, 0.0
    for separator, decimal in _DIALECTS:
        dialect = _Dialect(separator, decimal)
        rows = [fields for fields in map(dialect.fields, sampled) if _is_row(fields, dialect)]
        common = _commonest([len(row) for row in rows])
        numbers = sum(dialect.number(field) is not None for row in rows if len(row) == common for field in row)
        # two columns of numbers say more than one, whatever else fits
        merit = numbers / max(common * len(sampled), 1) * (1.0 if common > 1 else 0.5)
        if merit > most + 1e-9:
            best, most = dialect, merit
    if best is None or most < 0.25:
        raise CheckFailed(f"{file}: {_NO_TABLE}")
    return best


def _commonest(numbers: Sequence[int]) -> int:
    return max(set(numbers), key=numbers.count, default=0)


def _is_row(fields: Sequence[str], dialect: _Dialect) -> bool:
    """Numbers, with at most a few texts among them (a date, a comment, a status)."""
    numbers = [dialect.number(field) for field in fields]
    texts = sum(number is None for number in numbers)
    return any(number is not None and np.isfinite(number) for number in numbers) and texts <= len(fields) // 2


def _rows(file: Path, lines: Sequence[str], numbers: Sequence[int], dialect: _Dialect) -> tuple[int, list[str]]:
    """The first line of numbers, and what each column is: "number", "stamp" (a date and time), or "" for a text.

    CheckFailed where there is none, or a second table behind the first.
    """
    tail = [dialect.fields(line) for line in lines[-_SAMPLED:]]
    rows = [row for row in tail if _is_row(row, dialect)]
    width = _commonest([len(row) for row in rows])
    kinds = [_kind([row[column] for row in rows if len(row) == width], dialect) for column in range(width)]
    first = len(lines)
    for at in range(len(lines) - 1, -1, -1):
        row = dialect.fields(lines[at])
        if not _fits(row, kinds, dialect):
            before = sum(_fits(dialect.fields(line), kinds, dialect) for line in lines[max(0, at - _SAMPLED) : at])
            if before == 0:
                break
            if _may_begin(lines[at]) and first < len(lines):
                if before > _PREAMBLE_ROWS:
                    raise CheckFailed(
                        f"{file}:{numbers[at]}: a second table begins here, behind the rows of another: "
                        "one table is read; save them in files of their own"
                    )
                break
            continue  # a bad row among good ones: it is told when the values are read
        first = at
    if first == len(lines) or not any(kinds):
        raise CheckFailed(f"{file}: {_NO_TABLE}")
    if first + 1 < len(lines) and dialect.fields(lines[first]) == ["", *map(str, range(width - 1))]:
        first += 1  # pandas: an index, and columns that have numbers for names
    return first, kinds


def _kind(fields: Sequence[str], dialect: _Dialect) -> str:
    """What a column is by some of its fields; one that is empty throughout, behind a last comma, is a text."""
    numbers = [dialect.number(field) for field in fields]
    if not any(fields):
        return ""
    if sum(number is None for number in numbers) <= len(numbers) // 2:
        return "number"
    return "stamp" if is_stamp(dialect.plain(fields[-1])) else ""


def _may_begin(line: str) -> bool:
    """Whether a line that is no row is a header rather than a damaged or empty row: nothing in it is a number."""
    named = bool(line.strip(_NOTHING)) and not any(character.isdigit() for character in line)
    return named or line.lstrip()[:1] in _COMMENT


def _fits(row: Sequence[str], kinds: Sequence[str], dialect: _Dialect) -> bool:
    if len(row) != len(kinds):
        return False
    numbers = [dialect.number(field) for field, kind in zip(row, kinds, strict=True) if kind == "number"]
    return all(number is not None for number in numbers) and any(np.isfinite(n) for n in numbers if n is not None)


def _header(
    file: Path, before: Sequence[str], dialect: _Dialect, kinds: Sequence[str]
) -> tuple[list[str], list[str | None]]:
    """Names ("" where there are none) and units, from the last lines before the numbers."""
    count = len(kinds)
    nothing: list[str | None] = [None] * count
    candidates = []
    for line in reversed(before):
        text = line.strip("\r\n ").lstrip(_COMMENT).strip(" ")
        if text.strip(",;\t "):
            candidates.append(_names(text, dialect, count))
        if len(candidates) == 2:
            break
    if not candidates or len(candidates[0]) == 1 != count:
        return [""] * count, nothing
    if len(candidates[0]) != count:
        if _is_prose(before[-1]):
            return [""] * count, nothing
        raise CheckFailed(
            f"{file}:{len(before)}: the header has {len(candidates[0])} names, the rows have {count} values each"
        )
    units = [_units_row(fields, kinds) if len(fields) == count else None for fields in candidates]
    if units[0] and len(candidates) > 1 and len(candidates[1]) == count and not units[1]:
        return list(candidates[1]), units[0]
    if units[0] and not _as_names(candidates[0]) and all(map(_as_unit, filter(None, candidates[0]))):
        return [""] * count, units[0]
    if len(candidates) > 1 and units[1] and not units[0]:
        return list(candidates[0]), units[1]
    return list(candidates[0]), nothing


def _units_row(fields: Sequence[str], kinds: Sequence[str]) -> list[str | None] | None:
    """Units of the columns, where at least half of what stands above numbers is one; else None.

    What is none known here is handed on as it stands.
    """
    above = [field for field, kind in zip(fields, kinds, strict=True) if kind and field]
    if 2 * sum(_as_unit(field) not in (None, "1") for field in above) < max(len(above), 1):
        return None
    return [
        _as_unit(field) or (field if kind and field != "-" else None) for field, kind in zip(fields, kinds, strict=True)
    ]


def _names(text: str, dialect: _Dialect, count: int) -> list[str]:
    """Fields of a header of `count` columns: LabVIEW adds a comment's, and between spaces names may have some."""
    fields = dialect.fields(text)
    while len(fields) > count and (not fields[-1] or fields[-1].lower() == "comment"):
        fields.pop()
    if dialect.separator is None and len(fields) != count:
        for pattern in (r"\s{2,}|\t", r"\s+(?![(\[])"):
            split = re.split(pattern, text.strip())
            if len(split) == count:
                return split
    return fields


def _is_prose(line: str) -> bool:
    """A comment, or nothing but separators: no header that has lost a name."""
    return line.strip()[:1] in _COMMENT or not line.strip(",;\t ") or line.strip().startswith("**")


def _as_names(fields: Sequence[str]) -> bool:
    """Whether units may be meant as names, "s" and "V" as in a table without a units row."""
    return len(set(fields)) == len(fields) and all(fields)


def _as_unit(field: str) -> str | None:
    """A field of a units row, with or without brackets, as a unit."""
    inner = re.sub(r"^[(\[{<]\s*(.*?)\s*[)\]}>]$", r"\1", field)
    return inner if inner and known(inner) is not None else None


def _by_number(number: int, names: Sequence[str]) -> str:
    """What the column without a name is called that is the `number`-th."""
    return str(number) if str(number) not in names else f"column {number}"


def _unlike(names: Sequence[str]) -> list[str]:
    """Names of which no two are alike: the second x is called x.2."""
    found: list[str] = []
    for name in names:
        again = sum(each == name or each.rpartition(".")[0] == name for each in found)
        found.append(f"{name}.{again + 1}" if name in found else name)
    return found


def _values(
    file: Path, rows: Sequence[str], numbers: Sequence[int], dialect: _Dialect, kinds: Sequence[str]
) -> list[Array]:
    """A column (n,) for each kind; empty for texts. `numbers` (n,) are those of the rows' lines."""
    plain = all(kind == "number" for kind in kinds) and not any('"' in line for line in rows[:_SAMPLED])
    if plain and not (dialect.decimal == "," and any("." in line for line in rows)):
        quick = [line.replace(",", ".") for line in rows] if dialect.decimal == "," else rows
        try:
            table = np.loadtxt(quick, delimiter=dialect.separator, ndmin=2, comments=None)
        except ValueError:
            pass  # an empty field, a bad row: looked at one by one
        else:
            if len(table) == len(rows) and table.shape[1] == len(kinds):
                return [np.ascontiguousarray(column) for column in table.T]
    values = [np.full(len(rows) if kind else 0, np.nan) for kind in kinds]
    stamps: dict[int, list[str]] = {column: [] for column, kind in enumerate(kinds) if kind == "stamp"}
    for k, line in enumerate(rows):
        fields = dialect.fields(line)
        if len(fields) != len(kinds):
            raise CheckFailed(f"{file}:{numbers[k]}: {_ragged(fields, kinds, last=k == len(rows) - 1)}")
        for column, (field, kind) in enumerate(zip(fields, kinds, strict=True)):
            if kind == "stamp":
                stamps[column].append(dialect.plain(field))
            elif kind:
                number = dialect.number(field)
                if number is None:
                    raise CheckFailed(f"{file}:{numbers[k]}: {field[:40]!r} is no number")
                values[column][k] = number
    for column, texts in stamps.items():
        values[column] = stamps_s(texts)
        bad = np.flatnonzero(np.isnan(values[column]))
        if len(bad):
            raise CheckFailed(f"{file}:{numbers[bad[0]]}: {texts[bad[0]][:40]!r} is no time as in the other rows")
    return values


def _column(rows: Sequence[str], dialect: _Dialect, column: int) -> list[str]:
    return [dialect.fields(row)[column].translate(_MINUS) for row in rows]


def _ragged(fields: Sequence[str], kinds: Sequence[str], *, last: bool) -> str:
    why = "; the file's last row: it may be cut off, remove it" if last else ""
    return f"this row has not as many values as there are columns ({len(fields)}, the others have {len(kinds)}){why}"
