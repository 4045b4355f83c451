"""Figures of ``path_error_<axis>`` and ``uncompensated_<axis>``, one sample per millisecond, whoever advances it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from micromanip.rt.record import MAX_AXES, record

from .compiled import compiled

_EVERY_NS = 1_000_000
_TRUTH = {"path_error": "", "uncompensated": "uncompensated_"}
_MOST = len(_TRUTH) * MAX_AXES

FIGURES = record(("samples", "i8"), ("squares", "f8"), ("largest", "f8"))
"""Of one quantity over time."""

PATH_ERRORS = record(("due_ns", "i8"), ("count", "i8"), ("input", "i8", (_MOST,)), ("figures", FIGURES, (_MOST,)))
"""Which inputs of the plant they are, and when the next samples are due."""


@compiled
def note_errors(e: Any, signals: Any, now_ns: int) -> None:
    """Take a sample of each, if it is time."""
    if now_ns < e["due_ns"]:
        return
    e["due_ns"] = now_ns + _EVERY_NS
    for i in range(e["count"]):
        f, value = e["figures"][i], signals[e["input"][i]]["value"]
        f["samples"] += 1
        f["squares"] += value * value
        f["largest"] = max(f["largest"], abs(value))


class PathError:
    """Those of one plant."""

    def __init__(self, channels: Mapping[str, int]) -> None:
        """`channels` are the plant's inputs; those that it doesn't have are left out."""
        self.record = np.zeros(1, PATH_ERRORS)
        self._names = [name for name in channels if name.rsplit("_", 1)[0] in _TRUTH]
        self.record["count"] = len(self._names)
        self.record[0]["input"][: len(self._names)] = [channels[name] for name in self._names]
        self._before = self.record[0]["figures"].copy()
        """What came before the last report of what is new."""

    def note(self, signals: Any, now_ns: int) -> None:
        """See ``note_errors``."""
        note_errors(self.record[0], signals, now_ns)

    def report(self) -> dict[str, Any]:
        """By axis, since the start: rms, max, uncompensated_rms, uncompensated_max; None without samples."""
        return self._axes(_merged(self._before, self.record[0]["figures"]))

    def report_since_last(self) -> dict[str, Any]:
        """The same since the last call."""
        figures = self.record[0]["figures"]
        axes = self._axes(figures)
        self._before = _merged(self._before, figures)
        figures[:] = 0
        return axes

    def _axes(self, figures: Any) -> dict[str, Any]:
        axes: dict[str, Any] = {}
        for name, f in zip(self._names, figures.tolist(), strict=False):
            quantity, axis = name.rsplit("_", 1)
            samples, squares, largest = f
            axes.setdefault(axis, {})[f"{_TRUTH[quantity]}rms"] = math.sqrt(squares / samples) if samples else None
            axes[axis][f"{_TRUTH[quantity]}max"] = largest if samples else None
        return axes


def _merged(first: Any, second: Any) -> Any:
    both = first.copy()
    both["samples"] += second["samples"]
    both["squares"] += second["squares"]
    both["largest"] = np.maximum(first["largest"], second["largest"])
    return both
