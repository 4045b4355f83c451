"""Columns of a text: CSV of any dialect, and what oscilloscopes and LabVIEW write, with lines before the numbers.

The rows are found first: the dialect (separator, decimal mark) in which most lines near the middle are numbers, then
the first line from which on they are. The line before has the names, or the units, with the names in the line before
that; a few rows of numbers before these are settings. A text with rows of several tables is refused, whatever stands
between. Numbers have no marks between thousands; dates are ISO 8601 or DD.MM.YYYY.
"""

from __future__ import annotations

import contextlib
import csv
import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.files import marked_encoding, open_regular

from .table import Array, Table
from .units import known

_DIALECTS = (("\t", "."), ("\t", ","), (";", "."), (";", ","), (",", "."), (",", ","), (None, "."), (None, ","))
"""Separator (None: spaces) and decimal mark; the first of those that fit is taken. Commas within a field are quoted."""
_SAMPLED, _LOOKED_AT = 60, 500
_PREAMBLE_ROWS = 10
"""Rows of numbers that may stand among the lines before a table; more of them are a table of their own."""
_TOLD_TABLES, _EVEN = 4, 0.01
_COMMENT, _HEADER_LINES, _BETWEEN_LINES = "#%/*", 24, 12
_NOTHING = ',;"\t '
"""What a line without values consists of, as spreadsheets leave them behind the last row."""
_EMPTY = re.compile(
    r"|[-+]?(1\.#(inf|ind|[qs]nan)\d*|\u221e)|n/?a|\(?null\)?|none|nat|missing|-+|\?+|\*+|#(n/a|na|div/0!|value!|num!|ref!)|"
    r"over(flow|load|range)?|ovld|ol",
    re.IGNORECASE,
)
"""What is written where there is no number, beside nan and inf: by C, spreadsheets, databases, meters."""
_FORTRAN = re.compile(r"([-+]?[\d.]+)[dD]([-+]?\d+)")
_TYPES = re.compile(r"(float|double|single|real|u?int|integer|number|numeric|dbl|i|f)(8|16|32|64)?", re.IGNORECASE)
_ENDED = 0.05
"""Share of the rows that a column which is empty at the end has to have filled."""
_NO_TABLE = "not a table of numbers: one row per sample, separated by commas, semicolons, tabs or spaces, is read"
_TEXT = {9, 10, 11, 12, 13, 27, *range(32, 256)}
_OF_DAY = re.compile(
    r"(?:.*[^\d:.,])?(?:(?P<h>\d\d?):(?=\d\d:\d\d)|(?=\d+:\d+[.,]))"
    r"(?P<m>\d\d?):(?P<s>\d\d(?:[.,]\d+|:\d{3})?)(?: ?(?P<half>[AP])\.?M\.?)?",
    re.IGNORECASE,
)
_DAY_FIRST = re.compile(r"(\d\d?)\.(\d\d?)\.(\d{4})[.,]? ")
_ZONE = re.compile(r" ?(?:UTC|GMT|([+-]\d\d:?\d*))$")
_ONE_DIGIT = re.compile(r"(^|[T ])(\d:)")
_DAY_0 = datetime.datetime(2020, 1, 1, tzinfo=datetime.UTC)
"""Counted from here, seconds of today keep their tenths of a microsecond."""


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
        if self.decimal == ",":
            field = field.replace(".", " ").replace(",", ".")
        try:
            return float(field)
        except ValueError:
            written = _FORTRAN.fullmatch(field)
            return float("e".join(written.groups())) if written else np.nan if _EMPTY.fullmatch(field) else None


def read_text(file: Path) -> Table:
    """A text. CheckFailed, with the line, where it is no table, or a row of it has not as many values as the others."""
    with open_regular(file) as opened:
        every = _decoded(file, opened.read()).splitlines()
    while every and not every[-1].strip(_NOTHING):
        every.pop()
    numbers = [number for number, line in enumerate(every, 1) if line.strip()]
    lines = [every[number - 1] for number in numbers]
    dialect = _dialect(file, lines)
    used, kinds, notes = _rows(file, lines, numbers, dialect)
    lines, numbers = [lines[k] for k in used], [numbers[k] for k in used]
    names, units = _header(file, every[: numbers[0] - 1], dialect, kinds)
    values = _values(file, lines, numbers, dialect, kinds)
    named = _unlike([name or str(k) for k, name in enumerate(names, 1)])
    kept = [k for k, kind in enumerate(kinds) if kind and (names[k] or np.isfinite(values[k]).any())]
    stated = {named[k]: "s" if kinds[k] == "stamp" else units[k] for k in kept}
    rows = [dialect.fields(line) for line in lines[:: max(1, len(lines) // _SAMPLED)]]
    texts = {
        named[k]: next((row[k] for row in rows if dialect.number(row[k]) is None), rows[0][k])
        for k, kind in enumerate(kinds)
        if not kind and (rows[0][k] or names[k])
    }
    return Table(file, {named[k]: values[k] for k in kept}, stated, numbers, texts=texts, notes=notes)


def _decoded(file: Path, content: bytes) -> str:
    """The text: UTF-8, UTF-16 with its mark, or else Western Europe's code page, whose odd letters are replaced."""
    try:
        if marked := marked_encoding(content):
            return content.decode(marked)
        if any(byte not in _TEXT for byte in content[:4096]):
            raise CheckFailed(
                f"{file}: neither text nor a format that is known here; save it as CSV, .mat, .npz, HDF5 or Parquet"
            )
        return content.decode("utf-8").replace("\N{MINUS SIGN}", "-")
    except UnicodeDecodeError as problem:
        if problem.encoding.startswith("utf-16"):
            raise CheckFailed(f"{file}: byte {problem.start} is no UTF-16: the file is cut off or damaged") from problem
        return content.decode("cp1252", errors="replace")


def _dialect(file: Path, lines: Sequence[str]) -> _Dialect:
    """The dialect in which most of some lines from the last half of the text are rows."""
    last_half = lines[len(lines) // 2 :]
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


def _rows(
    file: Path, lines: Sequence[str], numbers: Sequence[int], dialect: _Dialect
) -> tuple[list[int], list[str], list[str]]:
    """Which of the lines are the table's; what each column is; notes.

    A column is "number", "stamp" (a date and time), or "" for a text. CheckFailed where there is no table, or a second
    one behind the first.
    """
    rows = [row for row in map(dialect.fields, lines[-_SAMPLED:]) if _is_row(row, dialect)]
    width = _commonest([len(row) for row in rows])
    rows = [row for row in rows if len(row) == width]
    kinds = [_kind([row[column] for row in rows], dialect) for column in range(width)]
    empty = [column for column in range(width) if not any(row[column] for row in rows)]
    if empty:  # a topic may have ended earlier
        looked_at = lines[:: max(1, len(lines) // _LOOKED_AT)]
        rows = [row for row in map(dialect.fields, looked_at) if len(row) == width and _is_row(row, dialect)]
        for column in empty:
            filled = sum(bool(row[column]) and dialect.number(row[column]) is not None for row in rows)
            kinds[column] = "number" if filled > _ENDED * len(rows) else ""
    last = len(lines)
    while (
        last
        and any(kinds)
        and not _fits(dialect.fields(lines[last - 1]), kinds, dialect)
        and _is_said(lines[last - 1], dialect)
    ):
        last -= 1
    notes = [f"{_places(numbers[last:])}: no rows, behind the table, left out"] if last < len(lines) else []
    lines = lines[:last]
    first, between = len(lines), []
    for at in range(len(lines) - 1, -1, -1):
        if _fits(dialect.fields(lines[at]), kinds, dialect):
            first = at
            continue
        before = sum(_fits(dialect.fields(line), kinds, dialect) for line in lines[max(0, at - _SAMPLED) : at])
        if first < len(lines) and (at + 1 in between or _may_begin(lines[at], dialect)):
            if _goes_on(lines[max(0, at - _BETWEEN_LINES) : first + 2], kinds, dialect):
                between.append(at)
                continue
            break
        if before == 0:
            break  # else it is a bad row among good ones, which is told when the values are read
    if first == len(lines) or not any(kinds):
        raise CheckFailed(f"{file}: {_NO_TABLE}")
    others, settings = _before(lines[:first], kinds, dialect)
    if others:
        every = [*others, (first, len(lines))]
        places = [f"{numbers[begin]} to {numbers[end - 1]}" for begin, end in every]
        told = ", ".join([*places[:_TOLD_TABLES], *(["..."] if len(places) > _TOLD_TABLES else [])])
        raise CheckFailed(
            f"{file}:{numbers[every[1][0] - 1]}: a second table begins here, behind the rows of another: one table is "
            f"read, save the one that is meant in a file of its own; there are {len(every)}, in lines {told}"
        )
    if settings:
        place = _places([numbers[at] for at in settings])
        notes.insert(0, f"{place}: numbers before the table, left out as settings")
    if between := [at for at in between if at > first]:
        more = len(between) - 1
        also = f", and {more} line{'s' * (more > 1)} more" if more else ""
        text = lines[between[-1]].strip()[:40]
        notes.append(f"line {numbers[between[-1]]}: {text!r} between rows that go on evenly behind it{also}, left out")
    return sorted({*range(first, last)} - {*between}), kinds, notes


def _places(numbers: Sequence[int]) -> str:
    return f"line {numbers[0]}" + (f" to {numbers[-1]}" if len(numbers) > 1 else "")


def _goes_on(lines: Sequence[str], kinds: Sequence[str], dialect: _Dialect) -> bool:
    """Whether a column rises evenly from the rows among `lines` to the last two, the first rows behind what is none."""
    rows = [fields for fields in map(dialect.fields, lines) if _fits(fields, kinds, dialect)][-4:]
    for column, kind in enumerate(kinds if len(rows) == 4 else ()):
        read = stamp_s if kind == "stamp" else dialect.number
        values = [np.nan if (found := read(row[column])) is None else found for row in rows]
        steps = np.diff(values)
        if kind and steps[0] > 0.0 and np.ptp(steps) < _EVEN * steps[0]:
            return True
    return False


def _before(lines: Sequence[str], kinds: Sequence[str], dialect: _Dialect) -> tuple[list[tuple[int, int]], list[int]]:
    """First and last line but one of each table in `lines`, and the rows that are too few for one."""
    tables: list[tuple[int, int]] = []
    settings: list[int] = []
    begin = width = 0
    for at, line in enumerate([*lines, ""]):
        fields = dialect.fields(line)
        values = all(dialect.number(field) is not None or stamp_s(field) is not None for field in fields)
        row = len(fields) > 1 and any(fields) and (values or _fits(fields, kinds, dialect))
        now = len(fields) if row else 0
        if now == width:
            continue
        if width and at - begin > _PREAMBLE_ROWS:
            tables.append((begin, at))
        elif width:
            settings += range(begin, at)
        begin, width = at, now
    return tables, settings


def _kind(fields: Sequence[str], dialect: _Dialect) -> str:
    """What a column is by some of its fields; one that is empty throughout, behind a last comma, is a text."""
    if not any(fields):
        return ""
    if 2 * sum(dialect.number(field) is None for field in fields) <= len(fields):
        return "number"
    return "stamp" if stamp_s(fields[-1]) is not None else ""


def _is_said(line: str, dialect: _Dialect) -> bool:
    """Whether a line begins with a word, as what is said behind a table does."""
    begin = dialect.fields(line)[:1]
    return bool(begin) and any(map(str.isalpha, begin[0])) and dialect.number(begin[0]) is None


def _may_begin(line: str, dialect: _Dialect) -> bool:
    """Whether a line that is no row is a header rather than a damaged or empty row: none of its fields is a number."""
    numbers = [dialect.number(field) for field in dialect.fields(line) if field]
    unnumbered = None in numbers and not any(number is not None and np.isfinite(number) for number in numbers)
    return unnumbered or line.lstrip()[:1] in _COMMENT


def _fits(row: Sequence[str], kinds: Sequence[str], dialect: _Dialect) -> bool:
    if len(row) != len(kinds):
        return False
    numbers = [dialect.number(field) for field, kind in zip(row, kinds, strict=True) if kind == "number"]
    return all(number is not None for number in numbers) and any(np.isfinite(n) for n in numbers if n is not None)


def _header(file: Path, before: Sequence[str], dialect: _Dialect, kinds: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names and units, "" where there are none, from the last lines before the numbers."""
    count, nothing = len(kinds), [""] * len(kinds)
    told = [line.strip("\r\n ").lstrip(_COMMENT).strip(" ") for line in before]
    lines = [_names(line, dialect, count) for line in told[-_HEADER_LINES:] if line.strip(_NOTHING)]
    keyed = {names[0]: names for names in lines if len(names) == count}
    if "Name" in keyed and kinds[0] == "number":  # TwinCAT's scope: keys above the times, in ms, of each group
        both = zip(keyed["Name"], keyed.get("Unit", nothing), strict=True)
        named = [("time", "ms") if name == "Name" else (name, unit) for name, unit in both]
        lines = [list(row) for row in zip(*named, strict=True)]
    # an oscilloscope has values in the header, whose names reach beyond the columns
    lines = [names[:count] if not kinds[-1] and len(names) > count else names for names in lines]
    lines = [names for names in lines if len(names) != count or not all(map(_TYPES.fullmatch, names))][-2:]
    if not lines or len(lines[-1]) == 1 != count:
        return nothing, nothing
    comment = before[-1].strip()[:1] in _COMMENT
    if comment and any(np.isfinite(dialect.number(name) or np.nan) for name in lines[-1]):
        return nothing, nothing  # "# gain of channel 20" has no names
    if len(lines[-1]) != count:
        if comment or not before[-1].strip(_NOTHING):
            return nothing, nothing  # a comment, or nothing but separators
        raise CheckFailed(
            f"{file}:{len(before)}: the header has {len(lines[-1])} names, the rows have {count} values each"
        )
    if len(lines) == 2 and len(lines[0]) == count and (units := _units_row(lines[1], kinds)):
        return lines[0], units
    return lines[-1], nothing


def _units_row(fields: Sequence[str], kinds: Sequence[str]) -> list[str]:
    """Units of the columns, where at least half of what stands above numbers is one; else none.

    A unit that is not known here is handed on as it stands.
    """
    bare = [re.sub(r"^[(\[{<]\s*(.*?)\s*[)\]}>]$", r"\1", field) for field in fields]
    above = [field for field, kind in zip(bare, kinds, strict=True) if kind and field]
    if 2 * sum(field != "1" and known(field) is not None for field in above) < max(len(above), 1):
        return []
    return ["" if not kind or _EMPTY.fullmatch(field) else field for field, kind in zip(bare, kinds, strict=True)]


def _names(text: str, dialect: _Dialect, count: int) -> list[str]:
    """Fields of a header of `count` columns: LabVIEW adds a comment's, and between spaces names may have some."""
    fields = dialect.fields(text)
    while len(fields) > count and (not fields[-1] or fields[-1].lower() == "comment"):
        fields.pop()
    if dialect.separator is None and len(fields) != count:
        apart = re.split(r"\s{2,}|\t", text.strip())
        return apart if len(apart) == count else re.split(r"\s+(?![(\[])", text.strip())
    return fields


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
    if all(kind == "number" for kind in kinds) and dialect.decimal == ".":
        with contextlib.suppress(ValueError):  # an empty field, quotes, a bad row: looked at one by one
            table = np.loadtxt(rows, delimiter=dialect.separator, ndmin=2, comments=None)
            if table.shape == (len(rows), len(kinds)):
                return [np.ascontiguousarray(column) for column in table.T]
    values = [np.full(len(rows) if kind else 0, np.nan) for kind in kinds]
    for k, line in enumerate(rows):
        fields = dialect.fields(line)
        if len(fields) != len(kinds):
            why = "; the file's last row: it may be cut off, remove it" if k == len(rows) - 1 else ""
            raise CheckFailed(
                f"{file}:{numbers[k]}: this row has not as many values as there are columns "
                f"({len(fields)}, the others have {len(kinds)}){why}"
            )
        for column, (field, kind) in enumerate(zip(fields, kinds, strict=True)):
            if not kind:
                continue
            found = stamp_s(field) if kind == "stamp" else dialect.number(field)
            if found is None:
                what = "no time as in the other rows" if kind == "stamp" else "no number"
                raise CheckFailed(f"{file}:{numbers[k]}: {field[:40]!r} is {what}")
            values[column][k] = found
    return [each - each[0] if kind == "stamp" else each for each, kind in zip(values, kinds, strict=True)]


def stamp_s(text: str) -> float | None:
    """Seconds of ``2026-11-24T10:00:00.5+01:00`` or ``24.11.2026 10:00:00,5``; None for what is no time.

    Of day where the date has two meanings or is missing: ``11/12/26 10:00:00 PM``, ``10:00.5``, ``10:00:00:500``.
    """
    text = _DAY_FIRST.sub(lambda found: f"{found[3]}-{found[2]:0>2}-{found[1]:0>2}T", text).replace("/", "-")
    text = _ZONE.sub(lambda found: found[1] or "Z", _ONE_DIGIT.sub(r"\g<1>0\2", text))
    with contextlib.suppress(ValueError):
        when = datetime.datetime.fromisoformat(text)
        return (when.replace(tzinfo=when.tzinfo or datetime.UTC) - _DAY_0).total_seconds() if ":" in text else None
    if (of_day := _OF_DAY.fullmatch(text)) is None:
        return None
    hour, half = int(of_day["h"] or 0), (of_day["half"] or "").upper()
    hour = hour % 12 + (12 if half == "P" else 0) if half else hour
    return 3600.0 * hour + 60.0 * int(of_day["m"]) + float(re.sub("[,:]", ".", of_day["s"]))
