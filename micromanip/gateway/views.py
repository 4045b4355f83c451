"""What a browser asks to see, and the binary message that shows it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from micromanip.errors import UsageError, did_you_mean

from .cell import Source
from .frames import frame
from .spectrum import on_grid, spectrum

_MOST_FIELDS = 24
_LEAST_SPAN_S, _MOST_SPAN_S = 1e-3, 86_400.0
_MOST_POINTS = 4000
_XY_POINTS = 6000
_SPECTRUM_S = 60.0
_ALWAYS = ("state",)
"""Columns that come with every frame, for the bands behind the traces."""


def number(query: Mapping[str, Any], name: str, least: float, most: float) -> float:
    """A number of a message; UsageError where it is none, or outside."""
    value = query.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise UsageError(f"{name} is a number from {least:g} to {most:g}, not {value!r:.40}")
    return float(value)


def names(query: Mapping[str, Any], source: Source | None) -> tuple[str, ...]:
    """The fields of a message, which are all known."""
    wanted = query.get("fields")
    if not isinstance(wanted, list) or len(wanted) > _MOST_FIELDS or not all(isinstance(name, str) for name in wanted):
        raise UsageError(f"fields are a list of up to {_MOST_FIELDS} names")
    known = [] if source is None else [field.name for field in source.fields]
    for name in wanted:
        if name not in known:
            raise UsageError(f"there is no field {name!r:.40}; {did_you_mean(name, known)}")
    return tuple(dict.fromkeys(wanted))


@dataclass(frozen=True)
class View:
    """`fields` over `span_s`, in about `points` points; `last` is the cycle at its end, None follows the newest."""

    fields: tuple[str, ...] = ()
    span_s: float = 1.0
    points: int = 800
    last: int | None = None

    @property
    def follows(self) -> bool:
        """Whether it moves on with the newest cycle."""
        return self.last is None

    @classmethod
    def read(cls, query: Mapping[str, Any], source: Source | None) -> Self:
        """What a client asked for; UsageError where it makes no sense."""
        last = query.get("last")
        return cls(
            names(query, source),
            number(query, "span_s", _LEAST_SPAN_S, _MOST_SPAN_S),
            round(number(query, "points", 10, _MOST_POINTS)),
            None if last is None else round(number(query, "last", 0, 2**53)),
        )

    def cycles(self, source: Source) -> int:
        """Its length in cycles."""
        return max(2, round(self.span_s * 1e9 / source.about["period_ns"]))


def frame_of(source: Source, view: View, last: int | None, more: Mapping[str, Any]) -> bytes:
    """The view up to the cycle `last`, None: the newest; `more` goes into the header."""
    history = source.history
    end = history.newest if last is None else last
    columns = [*view.fields, *(name for name in _ALWAYS if name not in view.fields)]
    first = end - view.cycles(source)
    window = history.window(history.index(columns), first, end, view.points)
    origin = int(window.cycles[0]) if len(window.cycles) else end
    arrays = {"cycles": (window.cycles - origin).astype(np.uint32)}
    for i, name in enumerate(columns):
        arrays[f"{name} low"] = window.low[i]
        if window.rows > 1:
            arrays[f"{name} high"] = window.high[i]
    header = {
        "type": "frame",
        "fields": list(view.fields),
        "origin": origin,
        "first": first,
        "last": end,
        "newest": history.newest,
        "oldest": history.oldest,
        "oldest_full": history.oldest_full,
        "rows": window.rows,
        "missing": window.missing,
        "lost": source.reader.lost,
        **source.so_far(),
        **more,
    }
    return frame(header, arrays)


def _span(source: Source, query: Mapping[str, Any]) -> tuple[int, int]:
    first = round(number(query, "first", -(2**53), 2**53))
    last = round(number(query, "last", 0, 2**53))
    if first >= last:
        raise UsageError("first is a cycle before last")
    return max(first, last - round(_SPECTRUM_S * 1e9 / source.about["period_ns"])), last


async def spectrum_of(source: Source, query: Mapping[str, Any]) -> bytes:
    """Amplitude densities of some fields over the cycles `first` to `last`, and their greatest lines."""
    fields, (first, last) = names(query, source), _span(source, query)
    if not fields:
        raise UsageError("a spectrum is of at least one field")
    history = source.history
    cycles, values = history.whole(history.index(fields), first, last)
    if not len(cycles):
        raise UsageError("these cycles are not there row by row any more")
    rate_Hz = 1e9 / source.about["period_ns"]

    def made() -> bytes:
        arrays, lines, missing, averages = {}, {}, 0.0, 0
        for name, row in zip(fields, values, strict=True):
            grid, missing = on_grid(cycles, row.astype(float))
            found = spectrum(grid, rate_Hz)
            if found is None:
                continue
            averages = found.averages
            arrays["frequency_Hz"] = found.frequency_Hz.astype(np.float32)
            arrays[name] = found.density.astype(np.float32)
            lines[name] = [[line.frequency_Hz, line.amplitude] for line in found.lines]
        seconds = (int(cycles[-1]) - int(cycles[0]) + 1) / rate_Hz
        header = {"type": "spectrum", "lines": lines, "missing": missing, "seconds": seconds, "averages": averages}
        return frame(header, arrays)

    return await asyncio.to_thread(made)


async def xy_of(source: Source, query: Mapping[str, Any]) -> bytes:
    """One field over another, each some cycles apart, so that there are not too many points."""
    fields, (first, last) = names(query, source), _span(source, query)
    if len(fields) != 2:
        raise UsageError("x-y takes two fields")
    history = source.history
    cycles, (x, y) = history.whole(history.index(fields), first, last)
    every = max(1, math.ceil(len(cycles) / _XY_POINTS))
    return frame({"type": "xy", "fields": list(fields), "every": every}, {"x": x[::every], "y": y[::every]})
