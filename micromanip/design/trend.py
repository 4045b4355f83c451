"""A trend for people: one line per day or hour, a picture, a file of some columns."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import system_error
from micromanip.faults import KINDS
from micromanip.recordings.table import Array, table_line
from micromanip.recordings.trend import (
    COUNTED,
    FAULT,
    MINUTE,
    STATE,
    STEP_S,
    TIME,
    Trend,
    day_file,
    matching,
    read_trend,
)
from micromanip.rt.states import STATE_NAMES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HOURLY_DAYS = 2
_ERROR = "error_um"
_CELLS, _BARS = 48, "▁▂▃▄▅▆▇█"
_DIGITS = 6
"""Significant ones, as many as the files have."""


def usual_fields(trend: Trend) -> list[str]:
    """Of each axis the rms of its error and the least headroom; the greatest lateness; deadlines missed."""
    errors = [name for name in matching(list(trend.columns), _ERROR) if name.endswith("_rms")]
    headroom = [name for name in matching(list(trend.columns), "headroom_V") if name.endswith("_min")]
    return [*errors, *headroom, "lateness_us_max", "overruns"]


def summarised(trend: Trend, fields: list[str]) -> list[dict[str, Any]]:
    """One line per day, or per hour of up to two days: `begins`, `running_h`, each column that `fields` mean, `faults`.

    Least and greatest values are those of all rows, what was counted is their sum; a mean and an rms are weighted by
    the time that a row covers. None where nothing was known. `state` is the last one's name, `faults` are codes.
    """
    spans_days = (trend.time[-1] - trend.time[0]) / np.timedelta64(1, "D")
    unit = "D" if spans_days > _HOURLY_DAYS else "h"
    begins = trend.time.astype(f"datetime64[{unit}]")
    edges = [0, *(np.flatnonzero(np.diff(begins)) + 1).tolist(), len(begins)]
    names = [name for name in _columns(trend, fields) if name != FAULT]
    return [_summary(trend, names, str(begins[low]), slice(low, high)) for low, high in itertools.pairwise(edges)]


class Course(NamedTuple):
    """How a column went over the time: a character for each of equal times, the lower the smaller, a blank for a gap.

    `least` and `greatest` are those of what is drawn, `last` is the newest row's that is known; None where none is.
    """

    field: str
    drawn: str
    least: float | None
    greatest: float | None
    last: float | None


def told(trend: Trend, fields: list[str]) -> dict[str, Any]:
    """The courses with the time that they go over, `from` .. `to`, as JSON has it."""
    went = [course._asdict() for course in courses(trend, fields)]
    return {"from": str(trend.time[0]), "to": str(trend.time[-1]), "courses": went}


def courses(trend: Trend, fields: list[str]) -> list[Course]:
    """One of each column of figures that `fields` mean; what they mean over a time is what `summarised` says."""
    names = [name for name in _columns(trend, fields) if name not in (STATE, FAULT)]
    since_s = (trend.time - trend.time[0]) / np.timedelta64(1, "s")
    within = np.minimum((since_s * (_CELLS / (since_s.max() + STEP_S[trend.every]))).astype(int), _CELLS - 1)
    edges = np.searchsorted(within, np.arange(_CELLS + 1))
    parts = [slice(low, high) for low, high in itertools.pairwise(edges.tolist())]
    return [_course(trend, name, parts) for name in names]


def _course(trend: Trend, name: str, parts: list[slice]) -> Course:
    values, covered = trend.columns[name], trend.columns["seconds"]
    cells = [_one(name, values[part], covered[part]) for part in parts]
    known = [float(value) for value in cells if value is not None]
    if not known:
        return Course(name, " " * len(cells), None, None, None)
    low, high = min(known), max(known)
    step = (high - low) / (len(_BARS) - 1) or 1.0
    drawn = "".join(" " if value is None else _BARS[round((float(value) - low) / step)] for value in cells)
    figures = (float(f"{value:.{_DIGITS}g}") for value in (low, high, values[np.isfinite(values)][-1]))
    return Course(name, drawn, *figures)


def whole(trend: Trend) -> dict[str, Any]:
    """All rows in one line of `summarised`: the rms of each axis' error, and the faults."""
    errors = [name for name in matching(list(trend.columns), _ERROR) if name.endswith("_rms")]
    return _summary(trend, errors, str(trend.time[0]), slice(None))


class LastDay(NamedTuple):
    """The newest 24 h of a trend: when they end (UTC), the state and the fault (a code, or None) of the last minute.

    `minutes` are rows, `error_um` is the median of their rms by axis; None where it was not known.
    """

    ends: str
    state: str
    fault: str | None
    minutes: int
    error_um: dict[str, float | None]


def last_day(folder: Path) -> LastDay:
    """Of the trend in `folder`. Raises CheckFailed where there is none, or it can't be read."""
    days = sorted({found.day for path in _listed(folder) if (found := day_file(path)) and found.every == MINUTE})
    trend = read_trend(folder, MINUTE, np.datetime64(days[-2:][0]) if days else None, fields=[_ERROR])
    end = trend.time[-1] + np.timedelta64(STEP_S[MINUTE], "s")
    of_day = trend.time >= end - np.timedelta64(1, "D")
    errors: dict[str, float | None] = {}
    for name in (name for name in matching(list(trend.columns), _ERROR) if name.endswith("_rms")):
        values = trend.columns[name][of_day]
        known = values[np.isfinite(values)]
        errors[name.removeprefix(f"{_ERROR}_").removesuffix("_rms")] = float(np.median(known)) if len(known) else None
    fault = int(trend.columns[FAULT][-1])
    state = str(_one(STATE, trend.columns[STATE][-1:], trend.columns["seconds"][-1:]))
    code = None if fault <= 0 else KINDS[fault].code if fault in KINDS else str(fault)
    return LastDay(str(end), state, code, int(of_day.sum()), errors)


def _listed(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError as problem:
        raise system_error(problem, folder) from problem


def write_csv(trend: Trend, fields: list[str], to: Path) -> None:
    """The rows as they are, of the columns that `fields` mean. Raises OSError."""
    names = _columns(trend, fields)
    with to.open("x", encoding="ascii") as file:
        file.write(",".join([TIME, *names]) + "\n")
        for k, stamp in enumerate(trend.time):
            file.write(table_line([str(stamp), *(f"{trend.columns[name][k]:.{_DIGITS}g}" for name in names)]) + "\n")


def draw(trend: Trend, fields: list[str], to: Path) -> None:
    """The figure of `drawn`, as .svg or .png. Raises OSError."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": "micromanip"}):
        drawn(trend, fields).savefig(to, dpi=130, metadata={"Date": None} if to.suffix == ".svg" else None)


def drawn(trend: Trend, fields: list[str]) -> Figure:
    """A panel for each quantity, over the time, UTC; what was not known, and time without rows, is left out."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    from .canvas import panels

    groups: dict[str, list[str]] = {}
    for name in _columns(trend, fields):
        groups.setdefault(_quantity(name), []).append(name)
    figure, places = panels(len(groups), f"Trend, a value a {trend.every}", 0.45 * max(len(groups), 2))
    for panel, (quantity, members) in zip(places, groups.items(), strict=True):
        for name in members:
            panel.plot(*_with_gaps(trend, trend.columns[name]), lw=0.9, label=name)
        panel.set_ylabel(quantity)
        panel.xaxis.set_major_formatter(ConciseDateFormatter(AutoDateLocator()))  # type: ignore[no-untyped-call]
        panel.grid(alpha=0.3)
        panel.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    places[-1].set_xlabel("UTC")
    return figure


def _columns(trend: Trend, fields: list[str]) -> list[str]:
    return list(dict.fromkeys(name for field in fields for name in matching(list(trend.columns), field)))


def _summary(trend: Trend, names: list[str], begins: str, part: slice) -> dict[str, Any]:
    covered = trend.columns["seconds"][part]
    found: dict[str, Any] = {"begins": begins, "running_h": round(float(np.nansum(covered)) / 3600.0, 4)}
    for name in names:
        value = _one(name, trend.columns[name][part], covered)
        found[name] = float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value
    codes = [int(code) for code in trend.columns[FAULT][part] if code > 0]
    found["faults"] = [KINDS[code].code if code in KINDS else str(code) for code in dict.fromkeys(codes)]
    return found


def _one(name: str, values: Array, covered: Array) -> float | str | None:
    known = np.isfinite(values)
    if not known.any():
        return None
    values, weights = values[known], np.fmax(covered[known], 1e-9)
    if name == STATE:
        last = int(values[-1])
        return STATE_NAMES[last] if 0 <= last < len(STATE_NAMES) else str(last)
    if name in COUNTED:
        return float(values.sum())
    if name.endswith("_max"):
        return float(values.max())
    if name.endswith("_mean"):
        return float(np.average(values, weights=weights))
    if name.endswith("_rms"):
        return float(np.sqrt(np.average(values**2, weights=weights)))
    return float(values.min())


def _quantity(name: str) -> str:
    """``error, um`` of ``error_um_x_rms``."""
    for unit in ("um", "V", "us"):
        before, found, _ = name.partition(f"_{unit}_")
        if found:
            return f"{before}, {unit}"
    return name


def _with_gaps(trend: Trend, values: Array) -> tuple[NDArray[np.datetime64], Array]:
    """With a NaN in each gap, over which no line is drawn."""
    ends = np.array([begin for begin, _ in trend.gaps()], trend.time.dtype)
    at = np.searchsorted(trend.time, ends)
    return np.insert(trend.time, at, ends), np.insert(values, at, np.nan)
