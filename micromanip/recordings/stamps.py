"""Times that are written as date and time, as time of day, or as days and a time, in seconds."""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence

import numpy as np

from .table import Array

_DAY_S = 86_400.0
_DAY_0 = datetime.date(2000, 1, 1)
"""Counted from here, seconds of today keep their tenths of a microsecond."""
_DATES = (
    r"(?P<year>\d{4})[-/](?P<month>\d\d?)[-/](?P<day>\d\d?)[T ]",
    r"(?P<tag>\d\d?)\.(?P<monat>\d\d?)\.(?P<jahr>\d{4})[.,]? ",
    r"(?P<one>\d\d?)/(?P<other>\d\d?)/(?P<of>\d{4}),? ",
    r"(?P<days>\d+) days? ",
)
_TIME = (
    r"(?P<hour>\d\d?):(?P<minute>\d\d):(?P<second>\d\d)(?:[.,](?P<part>\d*)|:(?P<ms>\d{3}))?(?: ?(?P<half>[AaPp])[Mm])?"
)
_ZONE = r"(?: ?(?:Z|UTC|GMT|(?P<east_h>[+-]\d\d)(?::?(?P<east_min>\d\d))?))?"
_STAMP = re.compile(f"(?:{'|'.join(_DATES)})?{_TIME}{_ZONE}")


def stamp_s(text: str, *, month_first: bool = False) -> float | None:
    """Seconds of ``2026-11-24T10:00:00.5+01:00``, ``24.11.2026 10:00:00.5``, ``10:00:00`` or ``0 days 10:00:00``.

    Of ``24/11/2026 3:00:00.5 PM`` the day is first, or the month, as it is said. None for anything else, and for a day
    that the calendar does not have, as of a logger whose clock was never set.
    """
    found = _STAMP.fullmatch(text)
    if not found:
        return None
    whole, hour = float(found["days"] or 0), int(found["hour"])
    if year := found["year"] or found["jahr"] or found["of"]:
        pair = (found["other"], found["one"]) if not month_first else (found["one"], found["other"])
        month, day = pair if found["of"] else (found["month"] or found["monat"], found["day"] or found["tag"])
        try:
            whole = float((datetime.date(int(year), int(month), int(day)) - _DAY_0).days)
        except ValueError:
            return None
    if half := found["half"]:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + 12 * (half in "Pp")
    east_h, east_min = found["east_h"], found["east_min"] or "0"
    east_s = (3600.0 * int(east_h[1:]) + 60.0 * int(east_min)) * (-1.0 if east_h[0] == "-" else 1.0) if east_h else 0.0
    second = float(f"{found['second']}.{found['part'] or found['ms'] or 0}")
    return _DAY_S * whole + 3600.0 * hour + 60.0 * int(found["minute"]) + second - east_s


def is_stamp(text: str) -> bool:
    """Whether it is a time in one of the orders of day and month."""
    return any(stamp_s(text, month_first=order) is not None for order in (False, True))


def stamps_s(texts: Sequence[str]) -> Array:
    """Seconds (n,) from the first one on, past midnight too where they are times of day; NaN for what is no stamp.

    Of day and month between slashes that comes first with which all are dates, and the record is the shortest.
    """
    readings = []
    for order in (False, True) if texts and "/" in texts[0] else (False,):
        found = [stamp_s(text, month_first=order) for text in texts]
        readings.append(_from_first_s(np.array([np.nan if one is None else one for one in found])))
    return min(readings, key=lambda one: (np.isnan(one).sum(), np.ptp(one)))


def _from_first_s(seconds: Array) -> Array:
    if np.all(seconds < _DAY_S):
        seconds = seconds + _DAY_S * np.concatenate([[0.0], np.cumsum(np.diff(seconds) < -0.5 * _DAY_S)])
    return np.asarray(seconds - seconds[0], dtype=float)
