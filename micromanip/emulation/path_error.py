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

PATH_ERRORS = record(
    ("due_ns", "i8"),
    ("count", "i8"),
    ("samples", "i8"),
    ("input", "i8", (_MOST,)),
    ("squares", "f8", (_MOST,)),
    ("largest", "f8", (_MOST,)),
)
"""Which inputs of the plant they are, when the next samples are due, and the sums over those that were taken."""


@compiled
def note_errors(e: Any, signals: Any, now_ns: int) -> None:
    """Take a sample of each, if it is time."""
    if now_ns < e["due_ns"]:
        return
    e["due_ns"] = now_ns + _EVERY_NS
    e["samples"] += 1
    inputs, squares, largest = e["input"], e["squares"], e["largest"]
    for i in range(e["count"]):
        value = signals[inputs[i]]["value"]
        squares[i] += value * value
        largest[i] = max(largest[i], abs(value))


class PathError:
    """Those of one plant."""

    def __init__(self, channels: Mapping[str, int]) -> None:
        """`channels` are the plant's inputs; those that it doesn't have are left out."""
        self.record = np.zeros(1, PATH_ERRORS)
        self._names = [name for name in channels if name.rsplit("_", 1)[0] in _TRUTH]
        self.record["count"] = len(self._names)
        self.record[0]["input"][: len(self._names)] = [channels[name] for name in self._names]
        self._errors = self.record[0]

    def note(self, signals: Any, now_ns: int) -> None:
        """See ``note_errors``."""
        note_errors(self._errors, signals, now_ns)

    def report(self) -> dict[str, Any]:
        """By axis, since the start: rms, max, uncompensated_rms, uncompensated_max; None without samples."""
        axes: dict[str, Any] = {}
        samples = int(self._errors["samples"])
        for i, name in enumerate(self._names):
            quantity, axis = name.rsplit("_", 1)
            rms = math.sqrt(self._errors["squares"][i] / samples) if samples else None
            axes.setdefault(axis, {})[f"{_TRUTH[quantity]}rms"] = rms
            axes[axis][f"{_TRUTH[quantity]}max"] = float(self._errors["largest"][i]) if samples else None
        return axes
