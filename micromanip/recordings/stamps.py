"""Times that are written as date and time, as time of day, or as days and a time, in seconds."""

from __future__ import annotations

import datetime
import re

import numpy as np

from .table import Array

_DAY_S = 86_400.0
_DAY_0 = datetime.date(2000, 1, 1)
"""Counted from here, seconds of today keep their tenths of a microsecond."""
_DATES = (r"(\d{4})[-/](\d\d)[-/](\d\d)[T ]", r"(\d\d?)\.(\d\d?)\.(\d{4}) ", r"(\d+) days? ")
_TIME = r"(\d\d?):(\d\d):(\d\d(?:\.\d*)?)(?:Z|([+-]\d\d):?(\d\d))?"
_STAMP = re.compile(f"(?:{'|'.join(_DATES)})?{_TIME}")


def stamp_s(text: str) -> float | None:
    """Seconds of ``2026-11-24T10:00:00.5+01:00``, ``24.11.2026 10:00:00.5``, ``10:00:00`` or ``0 days 10:00:00``.

    None for anything else, and for a day that the calendar does not have, as of a logger whose clock was never set.
    """
    found = _STAMP.fullmatch(text)
    if not found:
        return None
    year, month, day, tag, monat, jahr, days, hour, minute, second, east_h, east_min = found.groups()
    whole = float(days or 0)
    if year or jahr:
        try:
            date = datetime.date(int(year or jahr), int(month or monat), int(day or tag))
        except ValueError:
            return None
        whole = float((date - _DAY_0).days)
    east_s = (3600.0 * int(east_h[1:]) + 60.0 * int(east_min)) * (-1.0 if east_h[0] == "-" else 1.0) if east_h else 0.0
    return _DAY_S * whole + 3600.0 * int(hour) + 60.0 * int(minute) + float(second) - east_s


def from_first_s(seconds: Array) -> Array:
    """Stamps (n,) from the first one on, past midnight too where they are times of day."""
    if np.all(seconds < _DAY_S):
        seconds = seconds + _DAY_S * np.concatenate([[0.0], np.cumsum(np.diff(seconds) < -0.5 * _DAY_S)])
    return np.asarray(seconds - seconds[0], dtype=float)
